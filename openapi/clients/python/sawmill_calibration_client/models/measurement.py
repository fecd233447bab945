from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.drift_method import DriftMethod
from ..models.measurement_kind import MeasurementKind
from ..models.verdict import Verdict
from ..types import UNSET, Unset

T = TypeVar("T", bound="Measurement")


@_attrs_define
class Measurement:
    """What one calibration or drift check that succeeded measured; null where it does not show a value."""

    against_id: None | str
    """ The calibration that every change is counted from: of a calibration the one that was active then, of a drift
    check the one that it was asked to compare with. Null: there was none, and so no change. """
    at: datetime.datetime
    """ When its job ended. """
    cor_column_change_mm: float | None
    """ Change of u_c, mm. Null: no change. """
    cor_column_mm: float
    """ u_c, where the centre of rotation falls on the detector. In mm. """
    gain: float | None
    """ Factor between the phantom's model and the sinogram, in 1/mm. Null: a drift check has none. """
    kind: MeasurementKind
    """ What measured. """
    number: int
    """ Number of the measurement; it grows from measurement to measurement. """
    ray_change_mm: float | None
    """ RMS distance between the rays, up to a common scale, mm. Of a drift check with a baseline it is counted from
    that, as is `within_tolerance`. Null: there was nothing to compare with. """
    ray_change_tolerance_mm: float | None
    """ What it was held against. Null: no change, or a calibration of an earlier version. In mm. """
    ray_error_rms_mm: float | None
    """ The predicted ray error, RMS, mm. Null: a drift check, or a calibration without error bars. """
    ray_error_upper_95_mm: float | None
    """ What the ray error stays below in 95 of 100 cases, mm. Null as before. """
    rays_verdict: None | Verdict
    """ Of a calibration alone, not of an earlier version. """
    relative_residual: float
    """ No unit. Of a calibration what its model leaves of the sinogram; of a drift check what opposite rays differ
    by. The two cannot be compared. """
    scale_change_percent: float | None
    """ Change of the image's size, per cent. Null: no change, or not known. """
    scale_uncertainty_percent: float | None
    """ The image's millimetres are right to this with 95 %. """
    scanner_id: str
    """ Id of the scanner. """
    source_distance_mm: float | None
    """ R, distance from the source to the centre of rotation, mm. Null: a drift check does not see it. """
    source_to_detector_mm: float
    """ SDD; a drift check hardly sees it. In mm. """
    subject_id: str
    """ Id of the calibration, or of the drift check. """
    tilt_change_deg: float | None
    """ Change of tau, degrees. Null: no change. """
    tilt_deg: float
    """ tau, tilt of the detector against the ray through the centre of rotation. In degrees. """
    verdict: None | Verdict
    """ Of a calibration. Null: a drift check. """
    within_tolerance: bool | None
    """ Null: no change, or too uncertain to tell. """
    baseline_age_hours: float | None | Unset = UNSET
    """ Age of that baseline, a number of hours. Null: there was none. """
    baseline_looks: int | None | Unset = UNSET
    """ Number of drift checks in the baseline that it was compared with. Null: its change is absolute, counted from
    the calibration. """
    cor_column_baseline_change_mm: float | None | Unset = UNSET
    """ Change of u_c against the baseline, mm. Null: there was none. """
    cor_column_standard_deviation_mm: float | None | Unset = UNSET
    """ Of u_c, mm. Null: no error bars. """
    cor_column_tilt_covariance_mm_deg: float | None | Unset = UNSET
    """ Covariance of u_c and tau, mm times degrees, of a drift check's own errors. Null: a calibration, or an
    earlier version. """
    method: DriftMethod | None | Unset = UNSET
    """ How a drift check compared views. Null as before. """
    pooled_cor_column_mm: float | None | Unset = UNSET
    """ u_c, as these see it together, mm. Null as before. """
    pooled_cor_column_standard_deviation_mm: float | None | Unset = UNSET
    """ Of that, mm. Null as before. """
    pooled_looks: int | None | Unset = UNSET
    """ Number of drift checks by this method that are pooled: this one and those before it. Null: it is in no
    chart, or not yet. """
    pooled_tilt_deg: float | None | Unset = UNSET
    """ tau, as these see it together, degrees. Null as before. """
    pooled_tilt_standard_deviation_deg: float | None | Unset = UNSET
    """ Of that, degrees. Null as before. """
    source_to_detector_standard_deviation_mm: float | None | Unset = UNSET
    """ Of SDD, mm. Null: no error bars, or a drift check that held it. """
    tilt_baseline_change_deg: float | None | Unset = UNSET
    """ Change of tau against the baseline, degrees. Null: there was none. """
    tilt_standard_deviation_deg: float | None | Unset = UNSET
    """ Of tau, degrees. Null: no error bars. """

    def to_dict(self) -> dict[str, Any]:
        against_id: None | str
        against_id = self.against_id

        at = self.at.isoformat()

        cor_column_change_mm: float | None
        cor_column_change_mm = self.cor_column_change_mm

        cor_column_mm = self.cor_column_mm

        gain: float | None
        gain = self.gain

        kind = self.kind.value

        number = self.number

        ray_change_mm: float | None
        ray_change_mm = self.ray_change_mm

        ray_change_tolerance_mm: float | None
        ray_change_tolerance_mm = self.ray_change_tolerance_mm

        ray_error_rms_mm: float | None
        ray_error_rms_mm = self.ray_error_rms_mm

        ray_error_upper_95_mm: float | None
        ray_error_upper_95_mm = self.ray_error_upper_95_mm

        rays_verdict: None | str
        if isinstance(self.rays_verdict, Verdict):
            rays_verdict = self.rays_verdict.value
        else:
            rays_verdict = self.rays_verdict

        relative_residual = self.relative_residual

        scale_change_percent: float | None
        scale_change_percent = self.scale_change_percent

        scale_uncertainty_percent: float | None
        scale_uncertainty_percent = self.scale_uncertainty_percent

        scanner_id = self.scanner_id

        source_distance_mm: float | None
        source_distance_mm = self.source_distance_mm

        source_to_detector_mm = self.source_to_detector_mm

        subject_id = self.subject_id

        tilt_change_deg: float | None
        tilt_change_deg = self.tilt_change_deg

        tilt_deg = self.tilt_deg

        verdict: None | str
        if isinstance(self.verdict, Verdict):
            verdict = self.verdict.value
        else:
            verdict = self.verdict

        within_tolerance: bool | None
        within_tolerance = self.within_tolerance

        baseline_age_hours: float | None | Unset
        if isinstance(self.baseline_age_hours, Unset):
            baseline_age_hours = UNSET
        else:
            baseline_age_hours = self.baseline_age_hours

        baseline_looks: int | None | Unset
        if isinstance(self.baseline_looks, Unset):
            baseline_looks = UNSET
        else:
            baseline_looks = self.baseline_looks

        cor_column_baseline_change_mm: float | None | Unset
        if isinstance(self.cor_column_baseline_change_mm, Unset):
            cor_column_baseline_change_mm = UNSET
        else:
            cor_column_baseline_change_mm = self.cor_column_baseline_change_mm

        cor_column_standard_deviation_mm: float | None | Unset
        if isinstance(self.cor_column_standard_deviation_mm, Unset):
            cor_column_standard_deviation_mm = UNSET
        else:
            cor_column_standard_deviation_mm = self.cor_column_standard_deviation_mm

        cor_column_tilt_covariance_mm_deg: float | None | Unset
        if isinstance(self.cor_column_tilt_covariance_mm_deg, Unset):
            cor_column_tilt_covariance_mm_deg = UNSET
        else:
            cor_column_tilt_covariance_mm_deg = self.cor_column_tilt_covariance_mm_deg

        method: None | str | Unset
        if isinstance(self.method, Unset):
            method = UNSET
        elif isinstance(self.method, DriftMethod):
            method = self.method.value
        else:
            method = self.method

        pooled_cor_column_mm: float | None | Unset
        if isinstance(self.pooled_cor_column_mm, Unset):
            pooled_cor_column_mm = UNSET
        else:
            pooled_cor_column_mm = self.pooled_cor_column_mm

        pooled_cor_column_standard_deviation_mm: float | None | Unset
        if isinstance(self.pooled_cor_column_standard_deviation_mm, Unset):
            pooled_cor_column_standard_deviation_mm = UNSET
        else:
            pooled_cor_column_standard_deviation_mm = self.pooled_cor_column_standard_deviation_mm

        pooled_looks: int | None | Unset
        if isinstance(self.pooled_looks, Unset):
            pooled_looks = UNSET
        else:
            pooled_looks = self.pooled_looks

        pooled_tilt_deg: float | None | Unset
        if isinstance(self.pooled_tilt_deg, Unset):
            pooled_tilt_deg = UNSET
        else:
            pooled_tilt_deg = self.pooled_tilt_deg

        pooled_tilt_standard_deviation_deg: float | None | Unset
        if isinstance(self.pooled_tilt_standard_deviation_deg, Unset):
            pooled_tilt_standard_deviation_deg = UNSET
        else:
            pooled_tilt_standard_deviation_deg = self.pooled_tilt_standard_deviation_deg

        source_to_detector_standard_deviation_mm: float | None | Unset
        if isinstance(self.source_to_detector_standard_deviation_mm, Unset):
            source_to_detector_standard_deviation_mm = UNSET
        else:
            source_to_detector_standard_deviation_mm = self.source_to_detector_standard_deviation_mm

        tilt_baseline_change_deg: float | None | Unset
        if isinstance(self.tilt_baseline_change_deg, Unset):
            tilt_baseline_change_deg = UNSET
        else:
            tilt_baseline_change_deg = self.tilt_baseline_change_deg

        tilt_standard_deviation_deg: float | None | Unset
        if isinstance(self.tilt_standard_deviation_deg, Unset):
            tilt_standard_deviation_deg = UNSET
        else:
            tilt_standard_deviation_deg = self.tilt_standard_deviation_deg

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "against_id": against_id,
                "at": at,
                "cor_column_change_mm": cor_column_change_mm,
                "cor_column_mm": cor_column_mm,
                "gain": gain,
                "kind": kind,
                "number": number,
                "ray_change_mm": ray_change_mm,
                "ray_change_tolerance_mm": ray_change_tolerance_mm,
                "ray_error_rms_mm": ray_error_rms_mm,
                "ray_error_upper_95_mm": ray_error_upper_95_mm,
                "rays_verdict": rays_verdict,
                "relative_residual": relative_residual,
                "scale_change_percent": scale_change_percent,
                "scale_uncertainty_percent": scale_uncertainty_percent,
                "scanner_id": scanner_id,
                "source_distance_mm": source_distance_mm,
                "source_to_detector_mm": source_to_detector_mm,
                "subject_id": subject_id,
                "tilt_change_deg": tilt_change_deg,
                "tilt_deg": tilt_deg,
                "verdict": verdict,
                "within_tolerance": within_tolerance,
            }
        )
        if baseline_age_hours is not UNSET:
            field_dict["baseline_age_hours"] = baseline_age_hours
        if baseline_looks is not UNSET:
            field_dict["baseline_looks"] = baseline_looks
        if cor_column_baseline_change_mm is not UNSET:
            field_dict["cor_column_baseline_change_mm"] = cor_column_baseline_change_mm
        if cor_column_standard_deviation_mm is not UNSET:
            field_dict["cor_column_standard_deviation_mm"] = cor_column_standard_deviation_mm
        if cor_column_tilt_covariance_mm_deg is not UNSET:
            field_dict["cor_column_tilt_covariance_mm_deg"] = cor_column_tilt_covariance_mm_deg
        if method is not UNSET:
            field_dict["method"] = method
        if pooled_cor_column_mm is not UNSET:
            field_dict["pooled_cor_column_mm"] = pooled_cor_column_mm
        if pooled_cor_column_standard_deviation_mm is not UNSET:
            field_dict["pooled_cor_column_standard_deviation_mm"] = pooled_cor_column_standard_deviation_mm
        if pooled_looks is not UNSET:
            field_dict["pooled_looks"] = pooled_looks
        if pooled_tilt_deg is not UNSET:
            field_dict["pooled_tilt_deg"] = pooled_tilt_deg
        if pooled_tilt_standard_deviation_deg is not UNSET:
            field_dict["pooled_tilt_standard_deviation_deg"] = pooled_tilt_standard_deviation_deg
        if source_to_detector_standard_deviation_mm is not UNSET:
            field_dict["source_to_detector_standard_deviation_mm"] = source_to_detector_standard_deviation_mm
        if tilt_baseline_change_deg is not UNSET:
            field_dict["tilt_baseline_change_deg"] = tilt_baseline_change_deg
        if tilt_standard_deviation_deg is not UNSET:
            field_dict["tilt_standard_deviation_deg"] = tilt_standard_deviation_deg

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)

        def _parse_against_id(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        against_id = _parse_against_id(d.pop("against_id"))

        at = datetime.datetime.fromisoformat(d.pop("at"))

        def _parse_cor_column_change_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        cor_column_change_mm = _parse_cor_column_change_mm(d.pop("cor_column_change_mm"))

        cor_column_mm = d.pop("cor_column_mm")

        def _parse_gain(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        gain = _parse_gain(d.pop("gain"))

        kind = MeasurementKind(d.pop("kind"))

        number = d.pop("number")

        def _parse_ray_change_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        ray_change_mm = _parse_ray_change_mm(d.pop("ray_change_mm"))

        def _parse_ray_change_tolerance_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        ray_change_tolerance_mm = _parse_ray_change_tolerance_mm(d.pop("ray_change_tolerance_mm"))

        def _parse_ray_error_rms_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        ray_error_rms_mm = _parse_ray_error_rms_mm(d.pop("ray_error_rms_mm"))

        def _parse_ray_error_upper_95_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        ray_error_upper_95_mm = _parse_ray_error_upper_95_mm(d.pop("ray_error_upper_95_mm"))

        def _parse_rays_verdict(data: object) -> None | Verdict:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                rays_verdict_type_0 = Verdict(data)

                return rays_verdict_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | Verdict, data)

        rays_verdict = _parse_rays_verdict(d.pop("rays_verdict"))

        relative_residual = d.pop("relative_residual")

        def _parse_scale_change_percent(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        scale_change_percent = _parse_scale_change_percent(d.pop("scale_change_percent"))

        def _parse_scale_uncertainty_percent(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        scale_uncertainty_percent = _parse_scale_uncertainty_percent(d.pop("scale_uncertainty_percent"))

        scanner_id = d.pop("scanner_id")

        def _parse_source_distance_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        source_distance_mm = _parse_source_distance_mm(d.pop("source_distance_mm"))

        source_to_detector_mm = d.pop("source_to_detector_mm")

        subject_id = d.pop("subject_id")

        def _parse_tilt_change_deg(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        tilt_change_deg = _parse_tilt_change_deg(d.pop("tilt_change_deg"))

        tilt_deg = d.pop("tilt_deg")

        def _parse_verdict(data: object) -> None | Verdict:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                verdict_type_0 = Verdict(data)

                return verdict_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | Verdict, data)

        verdict = _parse_verdict(d.pop("verdict"))

        def _parse_within_tolerance(data: object) -> bool | None:
            if data is None:
                return data
            return cast(bool | None, data)

        within_tolerance = _parse_within_tolerance(d.pop("within_tolerance"))

        def _parse_baseline_age_hours(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        baseline_age_hours = _parse_baseline_age_hours(d.pop("baseline_age_hours", UNSET))

        def _parse_baseline_looks(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        baseline_looks = _parse_baseline_looks(d.pop("baseline_looks", UNSET))

        def _parse_cor_column_baseline_change_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        cor_column_baseline_change_mm = _parse_cor_column_baseline_change_mm(
            d.pop("cor_column_baseline_change_mm", UNSET)
        )

        def _parse_cor_column_standard_deviation_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        cor_column_standard_deviation_mm = _parse_cor_column_standard_deviation_mm(
            d.pop("cor_column_standard_deviation_mm", UNSET)
        )

        def _parse_cor_column_tilt_covariance_mm_deg(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        cor_column_tilt_covariance_mm_deg = _parse_cor_column_tilt_covariance_mm_deg(
            d.pop("cor_column_tilt_covariance_mm_deg", UNSET)
        )

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

        def _parse_pooled_cor_column_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        pooled_cor_column_mm = _parse_pooled_cor_column_mm(d.pop("pooled_cor_column_mm", UNSET))

        def _parse_pooled_cor_column_standard_deviation_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        pooled_cor_column_standard_deviation_mm = _parse_pooled_cor_column_standard_deviation_mm(
            d.pop("pooled_cor_column_standard_deviation_mm", UNSET)
        )

        def _parse_pooled_looks(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        pooled_looks = _parse_pooled_looks(d.pop("pooled_looks", UNSET))

        def _parse_pooled_tilt_deg(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        pooled_tilt_deg = _parse_pooled_tilt_deg(d.pop("pooled_tilt_deg", UNSET))

        def _parse_pooled_tilt_standard_deviation_deg(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        pooled_tilt_standard_deviation_deg = _parse_pooled_tilt_standard_deviation_deg(
            d.pop("pooled_tilt_standard_deviation_deg", UNSET)
        )

        def _parse_source_to_detector_standard_deviation_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        source_to_detector_standard_deviation_mm = _parse_source_to_detector_standard_deviation_mm(
            d.pop("source_to_detector_standard_deviation_mm", UNSET)
        )

        def _parse_tilt_baseline_change_deg(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        tilt_baseline_change_deg = _parse_tilt_baseline_change_deg(d.pop("tilt_baseline_change_deg", UNSET))

        def _parse_tilt_standard_deviation_deg(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        tilt_standard_deviation_deg = _parse_tilt_standard_deviation_deg(d.pop("tilt_standard_deviation_deg", UNSET))

        measurement = cls(
            against_id=against_id,
            at=at,
            cor_column_change_mm=cor_column_change_mm,
            cor_column_mm=cor_column_mm,
            gain=gain,
            kind=kind,
            number=number,
            ray_change_mm=ray_change_mm,
            ray_change_tolerance_mm=ray_change_tolerance_mm,
            ray_error_rms_mm=ray_error_rms_mm,
            ray_error_upper_95_mm=ray_error_upper_95_mm,
            rays_verdict=rays_verdict,
            relative_residual=relative_residual,
            scale_change_percent=scale_change_percent,
            scale_uncertainty_percent=scale_uncertainty_percent,
            scanner_id=scanner_id,
            source_distance_mm=source_distance_mm,
            source_to_detector_mm=source_to_detector_mm,
            subject_id=subject_id,
            tilt_change_deg=tilt_change_deg,
            tilt_deg=tilt_deg,
            verdict=verdict,
            within_tolerance=within_tolerance,
            baseline_age_hours=baseline_age_hours,
            baseline_looks=baseline_looks,
            cor_column_baseline_change_mm=cor_column_baseline_change_mm,
            cor_column_standard_deviation_mm=cor_column_standard_deviation_mm,
            cor_column_tilt_covariance_mm_deg=cor_column_tilt_covariance_mm_deg,
            method=method,
            pooled_cor_column_mm=pooled_cor_column_mm,
            pooled_cor_column_standard_deviation_mm=pooled_cor_column_standard_deviation_mm,
            pooled_looks=pooled_looks,
            pooled_tilt_deg=pooled_tilt_deg,
            pooled_tilt_standard_deviation_deg=pooled_tilt_standard_deviation_deg,
            source_to_detector_standard_deviation_mm=source_to_detector_standard_deviation_mm,
            tilt_baseline_change_deg=tilt_baseline_change_deg,
            tilt_standard_deviation_deg=tilt_standard_deviation_deg,
        )

        return measurement
