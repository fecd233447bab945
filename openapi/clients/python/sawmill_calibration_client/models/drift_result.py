from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.drift_method import DriftMethod
from ..models.drift_reference import DriftReference
from ..models.rotation import Rotation
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.detector_deviation import DetectorDeviation
    from ..models.detector_geometry import DetectorGeometry
    from ..models.drift_baseline import DriftBaseline
    from ..models.scanner_constants import ScannerConstants
    from ..models.turn_disturbance import TurnDisturbance


T = TypeVar("T", bound="DriftResult")


@_attrs_define
class DriftResult:
    """The answer: what moved, how surely, and what cannot be seen."""

    calibrated: DetectorGeometry
    """ The part of the geometry that a log shows. """
    change: DetectorGeometry
    """ The part of the geometry that a log shows. """
    change_standard_deviation: DetectorDeviation
    """ A standard deviation of each, or how many of them; null for the distance where the scan does not show it.
    """
    covariance: list[list[float]]
    """ Covariance of what was measured, (cor_column_mm, tilt_rad, source_to_detector_mm), in the products of their
    units. """
    input_sha256: str
    """ SHA-256 of the scan's file, in hexadecimal digits. """
    measured: DetectorGeometry
    """ The part of the geometry that a log shows. """
    moved: bool
    """ Whether any change is beyond three standard deviations. """
    not_seen: list[str]
    """ What no scan without a phantom can show. """
    radius_mm: float
    """ Of the disc in which rays are compared. In mm. """
    ray_change_mm: float
    """ RMS distance between the rays inside the log's disc, up to a common scale, with what this scan cannot see
    unchanged; a distance of the detector that has not significantly changed is held too. Counted from `reference`.
    """
    ray_change_uncertainty_mm: float
    """ RMS ray distance that the errors alone bring about. In mm. """
    reason: str
    """ A likely cause and what to do, in one sentence. """
    relative_residual: float
    """ What opposite rays differ by, against what changes with the view; or what sums of pairs of views differ by,
    against the sums. No unit. """
    rotation: Rotation
    """ Which way the view angles count: as the scan gives them, or the other way (phi becomes -phi). """
    rotation_decided: bool
    """ False: a log too round and centred to tell; the calibration's is kept. """
    rotation_ratio: float
    """ How many times worse they agree in the other sense, no unit. """
    rows: list[int]
    """ First row and the one after the last; [0, 1] of a scan that came as a mean of rows, of which `adjustments`
    has the number. """
    scanner: ScannerConstants
    """ What is known of a scanner without calibrating it. """
    significance: DetectorDeviation
    """ A standard deviation of each, or how many of them; null for the distance where the scan does not show it.
    """
    software_version: str
    """ Version of the software that computed it. """
    standard_deviation: DetectorDeviation
    """ A standard deviation of each, or how many of them; null for the distance where the scan does not show it.
    """
    time_s: float
    """ Seconds that the computation took. """
    tolerance_mm: float
    """ RMS ray distance up to which nothing moved. In mm. """
    views: int
    """ Number of views of the scan. """
    within_tolerance: bool | None
    """ False: a change beyond chance moved the rays, or the image's size, by more than is allowed. Null: the scan
    is too uncertain to say. """
    adjustments: list[str] | Unset = UNSET
    """ What was done to the scan before it was used, a sentence each. """
    at: datetime.datetime | None | Unset = UNSET
    """ When it ended. Null: from an earlier version. """
    baseline: DriftBaseline | None | Unset = UNSET
    """ What counts as zero, and the change from it. Null: there is no baseline. """
    disturbances: list[TurnDisturbance] | Unset = UNSET
    """ What disturbs the turn beyond chance. What is not found widens the standard deviations. """
    encoder_bound_mm: float | None | Unset = UNSET
    """ The most that an encoder that is wrong by 0.1 degrees once a turn still moves `cor_column_mm` of this log,
    one way or the other as the log lies; the standard deviations include it. Null: opposite rays were compared,
    with which an encoder is one of `disturbances`, or from an earlier version. """
    method: DriftMethod | None | Unset = UNSET
    """ How the views were compared. Null: from an earlier version. """
    reference: DriftReference | Unset = UNSET
    """ calibration: changes are absolute, counted from the calibration. baseline: they are counted from what the
    first logs after it measured. """
    scale_change_percent: float | None | Unset = UNSET
    """ Change of the image's size, which the ray change leaves out. Null: from an earlier version. In per cent. """
    scale_change_uncertainty_percent: float | None | Unset = UNSET
    """ Of the change of scale, 95 %. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.drift_baseline import DriftBaseline  # noqa: PLC0415

        calibrated = self.calibrated.to_dict()

        change = self.change.to_dict()

        change_standard_deviation = self.change_standard_deviation.to_dict()

        covariance = []
        for covariance_item_data in self.covariance:
            covariance_item = covariance_item_data

            covariance.append(covariance_item)

        input_sha256 = self.input_sha256

        measured = self.measured.to_dict()

        moved = self.moved

        not_seen = self.not_seen

        radius_mm = self.radius_mm

        ray_change_mm = self.ray_change_mm

        ray_change_uncertainty_mm = self.ray_change_uncertainty_mm

        reason = self.reason

        relative_residual = self.relative_residual

        rotation = self.rotation.value

        rotation_decided = self.rotation_decided

        rotation_ratio = self.rotation_ratio

        rows = []
        for rows_item_data in self.rows:
            rows_item: int
            rows_item = rows_item_data
            rows.append(rows_item)

        scanner = self.scanner.to_dict()

        significance = self.significance.to_dict()

        software_version = self.software_version

        standard_deviation = self.standard_deviation.to_dict()

        time_s = self.time_s

        tolerance_mm = self.tolerance_mm

        views = self.views

        within_tolerance: bool | None
        within_tolerance = self.within_tolerance

        adjustments: list[str] | Unset = UNSET
        if not isinstance(self.adjustments, Unset):
            adjustments = self.adjustments

        at: None | str | Unset
        if isinstance(self.at, Unset):
            at = UNSET
        elif isinstance(self.at, datetime.datetime):
            at = self.at.isoformat()
        else:
            at = self.at

        baseline: dict[str, Any] | None | Unset
        if isinstance(self.baseline, Unset):
            baseline = UNSET
        elif isinstance(self.baseline, DriftBaseline):
            baseline = self.baseline.to_dict()
        else:
            baseline = self.baseline

        disturbances: list[dict[str, Any]] | Unset = UNSET
        if not isinstance(self.disturbances, Unset):
            disturbances = []
            for disturbances_item_data in self.disturbances:
                disturbances_item = disturbances_item_data.to_dict()
                disturbances.append(disturbances_item)

        encoder_bound_mm: float | None | Unset
        if isinstance(self.encoder_bound_mm, Unset):
            encoder_bound_mm = UNSET
        else:
            encoder_bound_mm = self.encoder_bound_mm

        method: None | str | Unset
        if isinstance(self.method, Unset):
            method = UNSET
        elif isinstance(self.method, DriftMethod):
            method = self.method.value
        else:
            method = self.method

        reference: str | Unset = UNSET
        if not isinstance(self.reference, Unset):
            reference = self.reference.value

        scale_change_percent: float | None | Unset
        if isinstance(self.scale_change_percent, Unset):
            scale_change_percent = UNSET
        else:
            scale_change_percent = self.scale_change_percent

        scale_change_uncertainty_percent: float | None | Unset
        if isinstance(self.scale_change_uncertainty_percent, Unset):
            scale_change_uncertainty_percent = UNSET
        else:
            scale_change_uncertainty_percent = self.scale_change_uncertainty_percent

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "calibrated": calibrated,
                "change": change,
                "change_standard_deviation": change_standard_deviation,
                "covariance": covariance,
                "input_sha256": input_sha256,
                "measured": measured,
                "moved": moved,
                "not_seen": not_seen,
                "radius_mm": radius_mm,
                "ray_change_mm": ray_change_mm,
                "ray_change_uncertainty_mm": ray_change_uncertainty_mm,
                "reason": reason,
                "relative_residual": relative_residual,
                "rotation": rotation,
                "rotation_decided": rotation_decided,
                "rotation_ratio": rotation_ratio,
                "rows": rows,
                "scanner": scanner,
                "significance": significance,
                "software_version": software_version,
                "standard_deviation": standard_deviation,
                "time_s": time_s,
                "tolerance_mm": tolerance_mm,
                "views": views,
                "within_tolerance": within_tolerance,
            }
        )
        if adjustments is not UNSET:
            field_dict["adjustments"] = adjustments
        if at is not UNSET:
            field_dict["at"] = at
        if baseline is not UNSET:
            field_dict["baseline"] = baseline
        if disturbances is not UNSET:
            field_dict["disturbances"] = disturbances
        if encoder_bound_mm is not UNSET:
            field_dict["encoder_bound_mm"] = encoder_bound_mm
        if method is not UNSET:
            field_dict["method"] = method
        if reference is not UNSET:
            field_dict["reference"] = reference
        if scale_change_percent is not UNSET:
            field_dict["scale_change_percent"] = scale_change_percent
        if scale_change_uncertainty_percent is not UNSET:
            field_dict["scale_change_uncertainty_percent"] = scale_change_uncertainty_percent

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.detector_deviation import DetectorDeviation  # noqa: PLC0415
        from ..models.detector_geometry import DetectorGeometry  # noqa: PLC0415
        from ..models.drift_baseline import DriftBaseline  # noqa: PLC0415
        from ..models.scanner_constants import ScannerConstants  # noqa: PLC0415
        from ..models.turn_disturbance import TurnDisturbance  # noqa: PLC0415

        d = dict(src_dict)
        calibrated = DetectorGeometry.from_dict(d.pop("calibrated"))

        change = DetectorGeometry.from_dict(d.pop("change"))

        change_standard_deviation = DetectorDeviation.from_dict(d.pop("change_standard_deviation"))

        covariance = []
        _covariance = d.pop("covariance")
        for covariance_item_data in _covariance:
            covariance_item = cast(list[float], covariance_item_data)

            covariance.append(covariance_item)

        input_sha256 = d.pop("input_sha256")

        measured = DetectorGeometry.from_dict(d.pop("measured"))

        moved = d.pop("moved")

        not_seen = cast(list[str], d.pop("not_seen"))

        radius_mm = d.pop("radius_mm")

        ray_change_mm = d.pop("ray_change_mm")

        ray_change_uncertainty_mm = d.pop("ray_change_uncertainty_mm")

        reason = d.pop("reason")

        relative_residual = d.pop("relative_residual")

        rotation = Rotation(d.pop("rotation"))

        rotation_decided = d.pop("rotation_decided")

        rotation_ratio = d.pop("rotation_ratio")

        rows = []
        _rows = d.pop("rows")
        for rows_item_data in _rows:

            def _parse_rows_item(data: object) -> int:
                return cast(int, data)

            rows_item = _parse_rows_item(rows_item_data)

            rows.append(rows_item)

        scanner = ScannerConstants.from_dict(d.pop("scanner"))

        significance = DetectorDeviation.from_dict(d.pop("significance"))

        software_version = d.pop("software_version")

        standard_deviation = DetectorDeviation.from_dict(d.pop("standard_deviation"))

        time_s = d.pop("time_s")

        tolerance_mm = d.pop("tolerance_mm")

        views = d.pop("views")

        def _parse_within_tolerance(data: object) -> bool | None:
            if data is None:
                return data
            return cast(bool | None, data)

        within_tolerance = _parse_within_tolerance(d.pop("within_tolerance"))

        adjustments = cast(list[str], d.pop("adjustments", UNSET))

        def _parse_at(data: object) -> datetime.datetime | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                at_type_0 = datetime.datetime.fromisoformat(data)

                return at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None | Unset, data)

        at = _parse_at(d.pop("at", UNSET))

        def _parse_baseline(data: object) -> DriftBaseline | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                baseline_type_0 = DriftBaseline.from_dict(data)

                return baseline_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(DriftBaseline | None | Unset, data)

        baseline = _parse_baseline(d.pop("baseline", UNSET))

        _disturbances = d.pop("disturbances", UNSET)
        disturbances: list[TurnDisturbance] | Unset = UNSET
        if _disturbances is not UNSET:
            disturbances = []
            for disturbances_item_data in _disturbances:
                disturbances_item = TurnDisturbance.from_dict(disturbances_item_data)

                disturbances.append(disturbances_item)

        def _parse_encoder_bound_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        encoder_bound_mm = _parse_encoder_bound_mm(d.pop("encoder_bound_mm", UNSET))

        def _parse_method(data: object) -> DriftMethod | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                method_type_0 = DriftMethod(data)

                return method_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(DriftMethod | None | Unset, data)

        method = _parse_method(d.pop("method", UNSET))

        _reference = d.pop("reference", UNSET)
        reference: DriftReference | Unset
        if isinstance(_reference, Unset):
            reference = UNSET
        else:
            reference = DriftReference(_reference)

        def _parse_scale_change_percent(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        scale_change_percent = _parse_scale_change_percent(d.pop("scale_change_percent", UNSET))

        def _parse_scale_change_uncertainty_percent(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        scale_change_uncertainty_percent = _parse_scale_change_uncertainty_percent(
            d.pop("scale_change_uncertainty_percent", UNSET)
        )

        drift_result = cls(
            calibrated=calibrated,
            change=change,
            change_standard_deviation=change_standard_deviation,
            covariance=covariance,
            input_sha256=input_sha256,
            measured=measured,
            moved=moved,
            not_seen=not_seen,
            radius_mm=radius_mm,
            ray_change_mm=ray_change_mm,
            ray_change_uncertainty_mm=ray_change_uncertainty_mm,
            reason=reason,
            relative_residual=relative_residual,
            rotation=rotation,
            rotation_decided=rotation_decided,
            rotation_ratio=rotation_ratio,
            rows=rows,
            scanner=scanner,
            significance=significance,
            software_version=software_version,
            standard_deviation=standard_deviation,
            time_s=time_s,
            tolerance_mm=tolerance_mm,
            views=views,
            within_tolerance=within_tolerance,
            adjustments=adjustments,
            at=at,
            baseline=baseline,
            disturbances=disturbances,
            encoder_bound_mm=encoder_bound_mm,
            method=method,
            reference=reference,
            scale_change_percent=scale_change_percent,
            scale_change_uncertainty_percent=scale_change_uncertainty_percent,
        )

        return drift_result
