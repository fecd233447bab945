from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.drift_method import DriftMethod

if TYPE_CHECKING:
    from ..models.drift_finding import DriftFinding
    from ..models.known_baseline import KnownBaseline


T = TypeVar("T", bound="PooledDrift")


@_attrs_define
class PooledDrift:
    """Drift checks of a scanner by one method since its active calibration, together."""

    alarm: DriftFinding | None
    """ What it found first; the alarm stays open until another calibration is active. Null: nothing. """
    baseline: KnownBaseline | None
    """ What the first of them measured: zero. Null: not complete. """
    baseline_cor_column_mm: float | None
    """ u_c of the zero, mm. Null as before. """
    baseline_tilt_deg: float | None
    """ tau of the zero, degrees. Null as before. """
    calibration_id: str
    """ Id of the active calibration. """
    finding: DriftFinding
    """ What the chart of a scanner finds. """
    last_at: datetime.datetime
    """ When the newest of them ended. """
    looks: int
    """ Number of drift checks in the chart, no unit. """
    method: DriftMethod
    """ opposite-rays: every ray against the one from the other side, in dense scans all round. view-pairs: what any
    two views have in common, in scans of 8 views or more. """
    pooled_cor_column_mm: float
    """ u_c, as these see it together, mm. """
    pooled_cor_column_standard_deviation_mm: float
    """ Of that, mm. """
    pooled_looks: int
    """ Number of the newest of them that are pooled, no unit. """
    pooled_tilt_deg: float
    """ tau, as these see it together, degrees. """
    pooled_tilt_standard_deviation_deg: float
    """ Of that, degrees. """
    since: datetime.datetime
    """ When that became the active one. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.drift_finding import DriftFinding  # noqa: PLC0415
        from ..models.known_baseline import KnownBaseline  # noqa: PLC0415

        alarm: dict[str, Any] | None
        if isinstance(self.alarm, DriftFinding):
            alarm = self.alarm.to_dict()
        else:
            alarm = self.alarm

        baseline: dict[str, Any] | None
        if isinstance(self.baseline, KnownBaseline):
            baseline = self.baseline.to_dict()
        else:
            baseline = self.baseline

        baseline_cor_column_mm: float | None
        baseline_cor_column_mm = self.baseline_cor_column_mm

        baseline_tilt_deg: float | None
        baseline_tilt_deg = self.baseline_tilt_deg

        calibration_id = self.calibration_id

        finding = self.finding.to_dict()

        last_at = self.last_at.isoformat()

        looks = self.looks

        method = self.method.value

        pooled_cor_column_mm = self.pooled_cor_column_mm

        pooled_cor_column_standard_deviation_mm = self.pooled_cor_column_standard_deviation_mm

        pooled_looks = self.pooled_looks

        pooled_tilt_deg = self.pooled_tilt_deg

        pooled_tilt_standard_deviation_deg = self.pooled_tilt_standard_deviation_deg

        since = self.since.isoformat()

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "alarm": alarm,
                "baseline": baseline,
                "baseline_cor_column_mm": baseline_cor_column_mm,
                "baseline_tilt_deg": baseline_tilt_deg,
                "calibration_id": calibration_id,
                "finding": finding,
                "last_at": last_at,
                "looks": looks,
                "method": method,
                "pooled_cor_column_mm": pooled_cor_column_mm,
                "pooled_cor_column_standard_deviation_mm": pooled_cor_column_standard_deviation_mm,
                "pooled_looks": pooled_looks,
                "pooled_tilt_deg": pooled_tilt_deg,
                "pooled_tilt_standard_deviation_deg": pooled_tilt_standard_deviation_deg,
                "since": since,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.drift_finding import DriftFinding  # noqa: PLC0415
        from ..models.known_baseline import KnownBaseline  # noqa: PLC0415

        d = dict(src_dict)

        def _parse_alarm(data: object) -> DriftFinding | None:
            if data is None:
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                alarm_type_0 = DriftFinding.from_dict(data)

                return alarm_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(DriftFinding | None, data)

        alarm = _parse_alarm(d.pop("alarm"))

        def _parse_baseline(data: object) -> KnownBaseline | None:
            if data is None:
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                baseline_type_0 = KnownBaseline.from_dict(data)

                return baseline_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(KnownBaseline | None, data)

        baseline = _parse_baseline(d.pop("baseline"))

        def _parse_baseline_cor_column_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        baseline_cor_column_mm = _parse_baseline_cor_column_mm(d.pop("baseline_cor_column_mm"))

        def _parse_baseline_tilt_deg(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        baseline_tilt_deg = _parse_baseline_tilt_deg(d.pop("baseline_tilt_deg"))

        calibration_id = d.pop("calibration_id")

        finding = DriftFinding.from_dict(d.pop("finding"))

        last_at = datetime.datetime.fromisoformat(d.pop("last_at"))

        looks = d.pop("looks")

        method = DriftMethod(d.pop("method"))

        pooled_cor_column_mm = d.pop("pooled_cor_column_mm")

        pooled_cor_column_standard_deviation_mm = d.pop("pooled_cor_column_standard_deviation_mm")

        pooled_looks = d.pop("pooled_looks")

        pooled_tilt_deg = d.pop("pooled_tilt_deg")

        pooled_tilt_standard_deviation_deg = d.pop("pooled_tilt_standard_deviation_deg")

        since = datetime.datetime.fromisoformat(d.pop("since"))

        pooled_drift = cls(
            alarm=alarm,
            baseline=baseline,
            baseline_cor_column_mm=baseline_cor_column_mm,
            baseline_tilt_deg=baseline_tilt_deg,
            calibration_id=calibration_id,
            finding=finding,
            last_at=last_at,
            looks=looks,
            method=method,
            pooled_cor_column_mm=pooled_cor_column_mm,
            pooled_cor_column_standard_deviation_mm=pooled_cor_column_standard_deviation_mm,
            pooled_looks=pooled_looks,
            pooled_tilt_deg=pooled_tilt_deg,
            pooled_tilt_standard_deviation_deg=pooled_tilt_standard_deviation_deg,
            since=since,
        )

        return pooled_drift
