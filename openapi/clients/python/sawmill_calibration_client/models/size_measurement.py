from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="SizeMeasurement")


@_attrs_define
class SizeMeasurement:
    """A length of a phantom, as it was measured."""

    measured_mm: float
    """ The length that was measured, mm. """
    standard_uncertainty_mm: float
    """ Standard uncertainty of the measured length, mm. """
    what: str
    """ x or y: the drawing's extent along that axis. Any other words: another length. """
    expires_on: datetime.date | None | Unset = UNSET
    """ After this day an answer asks for a new measurement. """
    instrument: None | str | Unset = UNSET
    """ What it was measured with. Null: not stated. """
    measured_on: datetime.date | None | Unset = UNSET
    """ The day of the measurement. Null: not stated. """
    moisture_percent: float | None | Unset = UNSET
    """ Of the wood when it was measured, against its dry weight. In per cent. """
    nominal_mm: float | None | Unset = UNSET
    """ The length that it was meant to have, mm. Null: not stated. """

    def to_dict(self) -> dict[str, Any]:
        measured_mm = self.measured_mm

        standard_uncertainty_mm = self.standard_uncertainty_mm

        what = self.what

        expires_on: None | str | Unset
        if isinstance(self.expires_on, Unset):
            expires_on = UNSET
        elif isinstance(self.expires_on, datetime.date):
            expires_on = self.expires_on.isoformat()
        else:
            expires_on = self.expires_on

        instrument: None | str | Unset
        if isinstance(self.instrument, Unset):
            instrument = UNSET
        else:
            instrument = self.instrument

        measured_on: None | str | Unset
        if isinstance(self.measured_on, Unset):
            measured_on = UNSET
        elif isinstance(self.measured_on, datetime.date):
            measured_on = self.measured_on.isoformat()
        else:
            measured_on = self.measured_on

        moisture_percent: float | None | Unset
        if isinstance(self.moisture_percent, Unset):
            moisture_percent = UNSET
        else:
            moisture_percent = self.moisture_percent

        nominal_mm: float | None | Unset
        if isinstance(self.nominal_mm, Unset):
            nominal_mm = UNSET
        else:
            nominal_mm = self.nominal_mm

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "measured_mm": measured_mm,
                "standard_uncertainty_mm": standard_uncertainty_mm,
                "what": what,
            }
        )
        if expires_on is not UNSET:
            field_dict["expires_on"] = expires_on
        if instrument is not UNSET:
            field_dict["instrument"] = instrument
        if measured_on is not UNSET:
            field_dict["measured_on"] = measured_on
        if moisture_percent is not UNSET:
            field_dict["moisture_percent"] = moisture_percent
        if nominal_mm is not UNSET:
            field_dict["nominal_mm"] = nominal_mm

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        measured_mm = d.pop("measured_mm")

        standard_uncertainty_mm = d.pop("standard_uncertainty_mm")

        what = d.pop("what")

        def _parse_expires_on(data: object) -> datetime.date | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                expires_on_type_0 = datetime.date.fromisoformat(data)

                return expires_on_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.date | None | Unset, data)

        expires_on = _parse_expires_on(d.pop("expires_on", UNSET))

        def _parse_instrument(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        instrument = _parse_instrument(d.pop("instrument", UNSET))

        def _parse_measured_on(data: object) -> datetime.date | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                measured_on_type_0 = datetime.date.fromisoformat(data)

                return measured_on_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.date | None | Unset, data)

        measured_on = _parse_measured_on(d.pop("measured_on", UNSET))

        def _parse_moisture_percent(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        moisture_percent = _parse_moisture_percent(d.pop("moisture_percent", UNSET))

        def _parse_nominal_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        nominal_mm = _parse_nominal_mm(d.pop("nominal_mm", UNSET))

        size_measurement = cls(
            measured_mm=measured_mm,
            standard_uncertainty_mm=standard_uncertainty_mm,
            what=what,
            expires_on=expires_on,
            instrument=instrument,
            measured_on=measured_on,
            moisture_percent=moisture_percent,
            nominal_mm=nominal_mm,
        )

        return size_measurement
