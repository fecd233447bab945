from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="RetentionAsk")


@_attrs_define
class RetentionAsk:
    """Rules that are to hold from now on, in place of all earlier ones."""

    calibrations_bytes: int | None | Unset = UNSET
    """ Bytes that calibrations may have together; the oldest go first. """
    calibrations_days: int | None | Unset = UNSET
    """ Number of days after which a calibration that was never active goes. """
    confirmed: None | str | Unset = UNSET
    """ The `confirmed` of the preview that showed what would go. Null: nothing would. """
    drifts_days: int | None | Unset = UNSET
    """ Number of days after which a drift check goes; what it measured stays. """
    events_days: int | None | Unset = UNSET
    """ Number of days after which an event goes. """
    inspections_days: int | None | Unset = UNSET
    """ Number of days after which an inspection goes. """
    log_scans_bytes: int | None | Unset = UNSET
    """ Bytes that scans without a phantom may have together, uploads included; the oldest go first. """
    log_scans_days: int | None | Unset = UNSET
    """ Number of days after which a scan that names no phantom goes. """
    phantom_scans_bytes: int | None | Unset = UNSET
    """ Bytes that scans of phantoms may have together, uploads included; the oldest go first. """
    phantom_scans_days: int | None | Unset = UNSET
    """ Number of days after which a scan of a phantom goes. """
    reconstructions_bytes: int | None | Unset = UNSET
    """ Bytes that reconstructions may have together; the oldest go first. """
    reconstructions_days: int | None | Unset = UNSET
    """ Number of days after which a reconstruction goes. """

    def to_dict(self) -> dict[str, Any]:
        calibrations_bytes: int | None | Unset
        if isinstance(self.calibrations_bytes, Unset):
            calibrations_bytes = UNSET
        else:
            calibrations_bytes = self.calibrations_bytes

        calibrations_days: int | None | Unset
        if isinstance(self.calibrations_days, Unset):
            calibrations_days = UNSET
        else:
            calibrations_days = self.calibrations_days

        confirmed: None | str | Unset
        if isinstance(self.confirmed, Unset):
            confirmed = UNSET
        else:
            confirmed = self.confirmed

        drifts_days: int | None | Unset
        if isinstance(self.drifts_days, Unset):
            drifts_days = UNSET
        else:
            drifts_days = self.drifts_days

        events_days: int | None | Unset
        if isinstance(self.events_days, Unset):
            events_days = UNSET
        else:
            events_days = self.events_days

        inspections_days: int | None | Unset
        if isinstance(self.inspections_days, Unset):
            inspections_days = UNSET
        else:
            inspections_days = self.inspections_days

        log_scans_bytes: int | None | Unset
        if isinstance(self.log_scans_bytes, Unset):
            log_scans_bytes = UNSET
        else:
            log_scans_bytes = self.log_scans_bytes

        log_scans_days: int | None | Unset
        if isinstance(self.log_scans_days, Unset):
            log_scans_days = UNSET
        else:
            log_scans_days = self.log_scans_days

        phantom_scans_bytes: int | None | Unset
        if isinstance(self.phantom_scans_bytes, Unset):
            phantom_scans_bytes = UNSET
        else:
            phantom_scans_bytes = self.phantom_scans_bytes

        phantom_scans_days: int | None | Unset
        if isinstance(self.phantom_scans_days, Unset):
            phantom_scans_days = UNSET
        else:
            phantom_scans_days = self.phantom_scans_days

        reconstructions_bytes: int | None | Unset
        if isinstance(self.reconstructions_bytes, Unset):
            reconstructions_bytes = UNSET
        else:
            reconstructions_bytes = self.reconstructions_bytes

        reconstructions_days: int | None | Unset
        if isinstance(self.reconstructions_days, Unset):
            reconstructions_days = UNSET
        else:
            reconstructions_days = self.reconstructions_days

        field_dict: dict[str, Any] = {}

        field_dict.update({})
        if calibrations_bytes is not UNSET:
            field_dict["calibrations_bytes"] = calibrations_bytes
        if calibrations_days is not UNSET:
            field_dict["calibrations_days"] = calibrations_days
        if confirmed is not UNSET:
            field_dict["confirmed"] = confirmed
        if drifts_days is not UNSET:
            field_dict["drifts_days"] = drifts_days
        if events_days is not UNSET:
            field_dict["events_days"] = events_days
        if inspections_days is not UNSET:
            field_dict["inspections_days"] = inspections_days
        if log_scans_bytes is not UNSET:
            field_dict["log_scans_bytes"] = log_scans_bytes
        if log_scans_days is not UNSET:
            field_dict["log_scans_days"] = log_scans_days
        if phantom_scans_bytes is not UNSET:
            field_dict["phantom_scans_bytes"] = phantom_scans_bytes
        if phantom_scans_days is not UNSET:
            field_dict["phantom_scans_days"] = phantom_scans_days
        if reconstructions_bytes is not UNSET:
            field_dict["reconstructions_bytes"] = reconstructions_bytes
        if reconstructions_days is not UNSET:
            field_dict["reconstructions_days"] = reconstructions_days

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)

        def _parse_calibrations_bytes(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        calibrations_bytes = _parse_calibrations_bytes(d.pop("calibrations_bytes", UNSET))

        def _parse_calibrations_days(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        calibrations_days = _parse_calibrations_days(d.pop("calibrations_days", UNSET))

        def _parse_confirmed(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        confirmed = _parse_confirmed(d.pop("confirmed", UNSET))

        def _parse_drifts_days(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        drifts_days = _parse_drifts_days(d.pop("drifts_days", UNSET))

        def _parse_events_days(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        events_days = _parse_events_days(d.pop("events_days", UNSET))

        def _parse_inspections_days(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        inspections_days = _parse_inspections_days(d.pop("inspections_days", UNSET))

        def _parse_log_scans_bytes(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        log_scans_bytes = _parse_log_scans_bytes(d.pop("log_scans_bytes", UNSET))

        def _parse_log_scans_days(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        log_scans_days = _parse_log_scans_days(d.pop("log_scans_days", UNSET))

        def _parse_phantom_scans_bytes(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        phantom_scans_bytes = _parse_phantom_scans_bytes(d.pop("phantom_scans_bytes", UNSET))

        def _parse_phantom_scans_days(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        phantom_scans_days = _parse_phantom_scans_days(d.pop("phantom_scans_days", UNSET))

        def _parse_reconstructions_bytes(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        reconstructions_bytes = _parse_reconstructions_bytes(d.pop("reconstructions_bytes", UNSET))

        def _parse_reconstructions_days(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        reconstructions_days = _parse_reconstructions_days(d.pop("reconstructions_days", UNSET))

        retention_ask = cls(
            calibrations_bytes=calibrations_bytes,
            calibrations_days=calibrations_days,
            confirmed=confirmed,
            drifts_days=drifts_days,
            events_days=events_days,
            inspections_days=inspections_days,
            log_scans_bytes=log_scans_bytes,
            log_scans_days=log_scans_days,
            phantom_scans_bytes=phantom_scans_bytes,
            phantom_scans_days=phantom_scans_days,
            reconstructions_bytes=reconstructions_bytes,
            reconstructions_days=reconstructions_days,
        )

        return retention_ask
