from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.drift_finding_kind import DriftFindingKind
from ..types import UNSET, Unset

T = TypeVar("T", bound="DriftFinding")


@_attrs_define
class DriftFinding:
    """What the chart of a scanner finds."""

    evidence: float
    """ Chi-squared of the change that has most of it, no unit. """
    kind: DriftFindingKind
    """ learning: the baseline is not complete. quiet: nothing speaks against an unchanged scanner. jump: it moved
    at one time. trend: it has been moving since. """
    limit: float
    """ Evidence above this is a jump or a trend, no unit. """
    scatter: float
    """ How many times farther checks scatter than their errors say, at least 1, no unit. """
    began_at: datetime.datetime | None | Unset = UNSET
    """ When it moved, or began to. Null: it is learning or quiet. """
    began_between: list[datetime.datetime] | None | Unset = UNSET
    """ Where that time lies with 95 %. Null: as before. """
    cor_column_change_mm: float | None | Unset = UNSET
    """ Of a jump the change of u_c, mm; of a trend the change a day, mm. """
    cor_column_standard_deviation_mm: float | None | Unset = UNSET
    """ Of that, mm. """
    tilt_change_deg: float | None | Unset = UNSET
    """ Of a jump the change of tau, degrees; of a trend the change a day, degrees. """
    tilt_standard_deviation_deg: float | None | Unset = UNSET
    """ Of that, degrees. """

    def to_dict(self) -> dict[str, Any]:
        evidence = self.evidence

        kind = self.kind.value

        limit = self.limit

        scatter = self.scatter

        began_at: None | str | Unset
        if isinstance(self.began_at, Unset):
            began_at = UNSET
        elif isinstance(self.began_at, datetime.datetime):
            began_at = self.began_at.isoformat()
        else:
            began_at = self.began_at

        began_between: list[str] | None | Unset
        if isinstance(self.began_between, Unset):
            began_between = UNSET
        elif isinstance(self.began_between, list):
            began_between = []
            for began_between_type_0_item_data in self.began_between:
                began_between_type_0_item: str
                if isinstance(began_between_type_0_item_data, datetime.datetime):
                    began_between_type_0_item = began_between_type_0_item_data.isoformat()

                began_between.append(began_between_type_0_item)

        else:
            began_between = self.began_between

        cor_column_change_mm: float | None | Unset
        if isinstance(self.cor_column_change_mm, Unset):
            cor_column_change_mm = UNSET
        else:
            cor_column_change_mm = self.cor_column_change_mm

        cor_column_standard_deviation_mm: float | None | Unset
        if isinstance(self.cor_column_standard_deviation_mm, Unset):
            cor_column_standard_deviation_mm = UNSET
        else:
            cor_column_standard_deviation_mm = self.cor_column_standard_deviation_mm

        tilt_change_deg: float | None | Unset
        if isinstance(self.tilt_change_deg, Unset):
            tilt_change_deg = UNSET
        else:
            tilt_change_deg = self.tilt_change_deg

        tilt_standard_deviation_deg: float | None | Unset
        if isinstance(self.tilt_standard_deviation_deg, Unset):
            tilt_standard_deviation_deg = UNSET
        else:
            tilt_standard_deviation_deg = self.tilt_standard_deviation_deg

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "evidence": evidence,
                "kind": kind,
                "limit": limit,
                "scatter": scatter,
            }
        )
        if began_at is not UNSET:
            field_dict["began_at"] = began_at
        if began_between is not UNSET:
            field_dict["began_between"] = began_between
        if cor_column_change_mm is not UNSET:
            field_dict["cor_column_change_mm"] = cor_column_change_mm
        if cor_column_standard_deviation_mm is not UNSET:
            field_dict["cor_column_standard_deviation_mm"] = cor_column_standard_deviation_mm
        if tilt_change_deg is not UNSET:
            field_dict["tilt_change_deg"] = tilt_change_deg
        if tilt_standard_deviation_deg is not UNSET:
            field_dict["tilt_standard_deviation_deg"] = tilt_standard_deviation_deg

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        evidence = d.pop("evidence")

        kind = DriftFindingKind(d.pop("kind"))

        limit = d.pop("limit")

        scatter = d.pop("scatter")

        def _parse_began_at(data: object) -> datetime.datetime | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                began_at_type_0 = datetime.datetime.fromisoformat(data)

                return began_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None | Unset, data)

        began_at = _parse_began_at(d.pop("began_at", UNSET))

        def _parse_began_between(data: object) -> list[datetime.datetime] | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, list):
                    raise TypeError()
                began_between_type_0 = []
                _began_between_type_0 = data
                for began_between_type_0_item_data in _began_between_type_0:

                    def _parse_began_between_type_0_item(data: object) -> datetime.datetime:
                        if not isinstance(data, str):
                            raise TypeError()
                        began_between_type_0_item_type_0 = datetime.datetime.fromisoformat(data)

                        return began_between_type_0_item_type_0

                    began_between_type_0_item = _parse_began_between_type_0_item(began_between_type_0_item_data)

                    began_between_type_0.append(began_between_type_0_item)

                return began_between_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(list[datetime.datetime] | None | Unset, data)

        began_between = _parse_began_between(d.pop("began_between", UNSET))

        def _parse_cor_column_change_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        cor_column_change_mm = _parse_cor_column_change_mm(d.pop("cor_column_change_mm", UNSET))

        def _parse_cor_column_standard_deviation_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        cor_column_standard_deviation_mm = _parse_cor_column_standard_deviation_mm(
            d.pop("cor_column_standard_deviation_mm", UNSET)
        )

        def _parse_tilt_change_deg(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        tilt_change_deg = _parse_tilt_change_deg(d.pop("tilt_change_deg", UNSET))

        def _parse_tilt_standard_deviation_deg(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        tilt_standard_deviation_deg = _parse_tilt_standard_deviation_deg(d.pop("tilt_standard_deviation_deg", UNSET))

        drift_finding = cls(
            evidence=evidence,
            kind=kind,
            limit=limit,
            scatter=scatter,
            began_at=began_at,
            began_between=began_between,
            cor_column_change_mm=cor_column_change_mm,
            cor_column_standard_deviation_mm=cor_column_standard_deviation_mm,
            tilt_change_deg=tilt_change_deg,
            tilt_standard_deviation_deg=tilt_standard_deviation_deg,
        )

        return drift_finding
