from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast

from attrs import define as _attrs_define

from ..models.calibration_status import CalibrationStatus
from ..models.handedness import Handedness
from ..models.rotation import Rotation
from ..models.verdict import Verdict
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.calibration_limits import CalibrationLimits
    from ..models.calibration_links import CalibrationLinks
    from ..models.calibration_options import CalibrationOptions
    from ..models.comparison import Comparison
    from ..models.hypothesis import Hypothesis
    from ..models.predicted_ray_error import PredictedRayError
    from ..models.reported_source_frame import ReportedSourceFrame
    from ..models.residual import Residual
    from ..models.scanner_constants import ScannerConstants
    from ..models.search import Search
    from ..models.second_witness import SecondWitness
    from ..models.standard_deviation import StandardDeviation
    from ..models.theta import Theta
    from ..models.timing import Timing


T = TypeVar("T", bound="CalibrationSucceeded")


@_attrs_define
class CalibrationSucceeded:
    """With its answer."""

    covariance: list[list[float]] | None
    """ Covariance of (psi_rad, source_distance_mm, source_to_detector_mm, cor_column_mm, tilt_rad), in the products
    of their units; the row of a parameter that was held, or that the scan does not determine, is zero. Null without
    error bars. """
    created_at: datetime.datetime
    """ When it was created, RFC 3339, UTC. """
    gain: float
    """ Factor between the phantom's model and the sinogram: a line integral for each mm of wood, in 1/mm. """
    handedness: Handedness
    """ From which end the phantom was looked at: as drawn, or from behind (y becomes -y). """
    hypotheses: list[Hypothesis]
    """ All that were tried, best first. """
    id: str
    """ The resource's id, which the service gives. """
    input_sha256: str
    """ SHA-256 of the scan's file, in hexadecimal digits. """
    job_id: str
    """ Id of the job that computes it. """
    offset: float
    """ Background of the sinogram: a constant beside the phantom, in the unit of a line integral. """
    options: CalibrationOptions
    """ How to calibrate, apart from what. """
    phantom: str
    """ The phantom's name. """
    phantom_id: str
    """ Id of the phantom. """
    phantom_position_mm: list[float]
    """ Where the phantom's drawing lies in the image, (x, y) of its origin in mm from the centre of rotation. """
    predicted_ray_error_mm: None | PredictedRayError
    """ Null without error bars. In mm. """
    reasons: list[str]
    """ Why the verdict is not pass, and what else to know, a sentence each. """
    residual: Residual
    """ What the model leaves of the sinogram. """
    rotation: Rotation
    """ Which way the view angles count: as the scan gives them, or the other way (phi becomes -phi). """
    rows: list[int]
    """ Detector rows that were averaged: the first one and the one after the last. """
    scale_ray_error_mm: float
    """ What the rays inherit from the phantom's size tolerance (RMS, systematic); no residual shows it. In mm. """
    scale_uncertainty_mm: float
    """ What R inherits from the phantom's size tolerance: a systematic share. In mm. """
    scan_id: str
    """ Id of the scan that shows the phantom. """
    scanner: ScannerConstants
    """ What is known of a scanner without calibrating it. """
    scanner_id: str
    """ Id of the scanner that is calibrated. """
    search: Search
    """ How the basin was found. """
    software_version: str
    """ Version of the software that computed it. """
    source_frame: ReportedSourceFrame
    """ The geometry with the source on the axis, what the data can see, with its magnification. """
    standard_deviation: None | StandardDeviation
    """ Null from a method that has no error bars. """
    state: Literal["succeeded"]
    """ State of its job: there is an answer. """
    theta: Theta
    """ The five numbers that cannot be measured by hand: theta = (alpha0, r_D, h_S, h_D, alpha_D). """
    theta_twin: None | Theta
    """ The other theta with the same sinogram; null where the source shift is zero. """
    timing_s: Timing
    """ Seconds; total runs from the sinogram in memory to the complete answer. """
    unconstrained_source_distance_mm: float
    """ R before it was held at source_to_cor_mm, if it was. """
    verdict: Verdict
    """ pass: within tolerance, nothing speaks against it. watch: look at it. fail: do not use it. """
    views: int
    """ Number of views that were used. """
    adjustments: list[str] | Unset = UNSET
    """ What was found in the scan beyond the plain model, and done. """
    answered_from: None | str | Unset = UNSET
    """ Id of the earlier one of its kind whose result it has: computed of the same input, with the same parameters
    and the same version of the software. The seconds in the result are those of that computation. Null: it was
    computed itself, or has no result. """
    comparison: Comparison | None | Unset = UNSET
    """ What changed since the scanner's active calibration. Null: there was none. """
    limits: CalibrationLimits | None | Unset = UNSET
    """ What the verdict was held against. Null: an answer of an earlier version, which did not keep it. """
    links: CalibrationLinks | None | Unset = UNSET
    """ Where it and its files are. """
    rays_verdict: None | Unset | Verdict = UNSET
    """ The verdict on the rays alone, whether they are right among themselves up to a common scale. Null: an answer
    of an earlier version. """
    scale_uncertainty_percent: float | None | Unset = UNSET
    """ The image's millimetres are right to this with 95 %: 1.96 times the standard uncertainties of the phantom's
    size and of R/SDD, in quadrature, and half the phantom's aspect. Null: an answer of an earlier version. """
    schedule_id: None | str | Unset = UNSET
    """ Id of the schedule that asked for it. Null: a person or a program did. """
    second_witness: None | SecondWitness | Unset = UNSET
    """ The log beside the phantom as a second witness for u_c and tilt; null where the scan shows none, or has
    fewer than 8 views. """
    status: CalibrationStatus | None | Unset = UNSET
    """ How far the answer may be relied on; the verdict is pass only where it is calibrated. Null: an answer of an
    earlier version, which did not report it. """
    theta_covariance: list[list[float]] | None | Unset = UNSET
    """ Covariance of (initial_angle_rad, detector_to_cor_mm, source_shift_mm, detector_shift_mm, detector_tilt), in
    the products of their units; null where the source shift or the first angle is not resolved. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.calibration_limits import CalibrationLimits  # noqa: PLC0415
        from ..models.calibration_links import CalibrationLinks  # noqa: PLC0415
        from ..models.comparison import Comparison  # noqa: PLC0415
        from ..models.predicted_ray_error import PredictedRayError  # noqa: PLC0415
        from ..models.second_witness import SecondWitness  # noqa: PLC0415
        from ..models.standard_deviation import StandardDeviation  # noqa: PLC0415
        from ..models.theta import Theta  # noqa: PLC0415

        covariance: list[list[float]] | None
        if isinstance(self.covariance, list):
            covariance = []
            for covariance_type_0_item_data in self.covariance:
                covariance_type_0_item = covariance_type_0_item_data

                covariance.append(covariance_type_0_item)

        else:
            covariance = self.covariance

        created_at = self.created_at.isoformat()

        gain = self.gain

        handedness = self.handedness.value

        hypotheses = []
        for hypotheses_item_data in self.hypotheses:
            hypotheses_item = hypotheses_item_data.to_dict()
            hypotheses.append(hypotheses_item)

        id = self.id

        input_sha256 = self.input_sha256

        job_id = self.job_id

        offset = self.offset

        options = self.options.to_dict()

        phantom = self.phantom

        phantom_id = self.phantom_id

        phantom_position_mm = []
        for phantom_position_mm_item_data in self.phantom_position_mm:
            phantom_position_mm_item: float
            phantom_position_mm_item = phantom_position_mm_item_data
            phantom_position_mm.append(phantom_position_mm_item)

        predicted_ray_error_mm: dict[str, Any] | None
        if isinstance(self.predicted_ray_error_mm, PredictedRayError):
            predicted_ray_error_mm = self.predicted_ray_error_mm.to_dict()
        else:
            predicted_ray_error_mm = self.predicted_ray_error_mm

        reasons = self.reasons

        residual = self.residual.to_dict()

        rotation = self.rotation.value

        rows = []
        for rows_item_data in self.rows:
            rows_item: int
            rows_item = rows_item_data
            rows.append(rows_item)

        scale_ray_error_mm = self.scale_ray_error_mm

        scale_uncertainty_mm = self.scale_uncertainty_mm

        scan_id = self.scan_id

        scanner = self.scanner.to_dict()

        scanner_id = self.scanner_id

        search = self.search.to_dict()

        software_version = self.software_version

        source_frame = self.source_frame.to_dict()

        standard_deviation: dict[str, Any] | None
        if isinstance(self.standard_deviation, StandardDeviation):
            standard_deviation = self.standard_deviation.to_dict()
        else:
            standard_deviation = self.standard_deviation

        state = self.state

        theta = self.theta.to_dict()

        theta_twin: dict[str, Any] | None
        if isinstance(self.theta_twin, Theta):
            theta_twin = self.theta_twin.to_dict()
        else:
            theta_twin = self.theta_twin

        timing_s = self.timing_s.to_dict()

        unconstrained_source_distance_mm = self.unconstrained_source_distance_mm

        verdict = self.verdict.value

        views = self.views

        adjustments: list[str] | Unset = UNSET
        if not isinstance(self.adjustments, Unset):
            adjustments = self.adjustments

        answered_from: None | str | Unset
        if isinstance(self.answered_from, Unset):
            answered_from = UNSET
        else:
            answered_from = self.answered_from

        comparison: dict[str, Any] | None | Unset
        if isinstance(self.comparison, Unset):
            comparison = UNSET
        elif isinstance(self.comparison, Comparison):
            comparison = self.comparison.to_dict()
        else:
            comparison = self.comparison

        limits: dict[str, Any] | None | Unset
        if isinstance(self.limits, Unset):
            limits = UNSET
        elif isinstance(self.limits, CalibrationLimits):
            limits = self.limits.to_dict()
        else:
            limits = self.limits

        links: dict[str, Any] | None | Unset
        if isinstance(self.links, Unset):
            links = UNSET
        elif isinstance(self.links, CalibrationLinks):
            links = self.links.to_dict()
        else:
            links = self.links

        rays_verdict: None | str | Unset
        if isinstance(self.rays_verdict, Unset):
            rays_verdict = UNSET
        elif isinstance(self.rays_verdict, Verdict):
            rays_verdict = self.rays_verdict.value
        else:
            rays_verdict = self.rays_verdict

        scale_uncertainty_percent: float | None | Unset
        if isinstance(self.scale_uncertainty_percent, Unset):
            scale_uncertainty_percent = UNSET
        else:
            scale_uncertainty_percent = self.scale_uncertainty_percent

        schedule_id: None | str | Unset
        if isinstance(self.schedule_id, Unset):
            schedule_id = UNSET
        else:
            schedule_id = self.schedule_id

        second_witness: dict[str, Any] | None | Unset
        if isinstance(self.second_witness, Unset):
            second_witness = UNSET
        elif isinstance(self.second_witness, SecondWitness):
            second_witness = self.second_witness.to_dict()
        else:
            second_witness = self.second_witness

        status: None | str | Unset
        if isinstance(self.status, Unset):
            status = UNSET
        elif isinstance(self.status, CalibrationStatus):
            status = self.status.value
        else:
            status = self.status

        theta_covariance: list[list[float]] | None | Unset
        if isinstance(self.theta_covariance, Unset):
            theta_covariance = UNSET
        elif isinstance(self.theta_covariance, list):
            theta_covariance = []
            for theta_covariance_type_0_item_data in self.theta_covariance:
                theta_covariance_type_0_item = theta_covariance_type_0_item_data

                theta_covariance.append(theta_covariance_type_0_item)

        else:
            theta_covariance = self.theta_covariance

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "covariance": covariance,
                "created_at": created_at,
                "gain": gain,
                "handedness": handedness,
                "hypotheses": hypotheses,
                "id": id,
                "input_sha256": input_sha256,
                "job_id": job_id,
                "offset": offset,
                "options": options,
                "phantom": phantom,
                "phantom_id": phantom_id,
                "phantom_position_mm": phantom_position_mm,
                "predicted_ray_error_mm": predicted_ray_error_mm,
                "reasons": reasons,
                "residual": residual,
                "rotation": rotation,
                "rows": rows,
                "scale_ray_error_mm": scale_ray_error_mm,
                "scale_uncertainty_mm": scale_uncertainty_mm,
                "scan_id": scan_id,
                "scanner": scanner,
                "scanner_id": scanner_id,
                "search": search,
                "software_version": software_version,
                "source_frame": source_frame,
                "standard_deviation": standard_deviation,
                "state": state,
                "theta": theta,
                "theta_twin": theta_twin,
                "timing_s": timing_s,
                "unconstrained_source_distance_mm": unconstrained_source_distance_mm,
                "verdict": verdict,
                "views": views,
            }
        )
        if adjustments is not UNSET:
            field_dict["adjustments"] = adjustments
        if answered_from is not UNSET:
            field_dict["answered_from"] = answered_from
        if comparison is not UNSET:
            field_dict["comparison"] = comparison
        if limits is not UNSET:
            field_dict["limits"] = limits
        if links is not UNSET:
            field_dict["links"] = links
        if rays_verdict is not UNSET:
            field_dict["rays_verdict"] = rays_verdict
        if scale_uncertainty_percent is not UNSET:
            field_dict["scale_uncertainty_percent"] = scale_uncertainty_percent
        if schedule_id is not UNSET:
            field_dict["schedule_id"] = schedule_id
        if second_witness is not UNSET:
            field_dict["second_witness"] = second_witness
        if status is not UNSET:
            field_dict["status"] = status
        if theta_covariance is not UNSET:
            field_dict["theta_covariance"] = theta_covariance

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.calibration_limits import CalibrationLimits  # noqa: PLC0415
        from ..models.calibration_links import CalibrationLinks  # noqa: PLC0415
        from ..models.calibration_options import CalibrationOptions  # noqa: PLC0415
        from ..models.comparison import Comparison  # noqa: PLC0415
        from ..models.hypothesis import Hypothesis  # noqa: PLC0415
        from ..models.predicted_ray_error import PredictedRayError  # noqa: PLC0415
        from ..models.reported_source_frame import ReportedSourceFrame  # noqa: PLC0415
        from ..models.residual import Residual  # noqa: PLC0415
        from ..models.scanner_constants import ScannerConstants  # noqa: PLC0415
        from ..models.search import Search  # noqa: PLC0415
        from ..models.second_witness import SecondWitness  # noqa: PLC0415
        from ..models.standard_deviation import StandardDeviation  # noqa: PLC0415
        from ..models.theta import Theta  # noqa: PLC0415
        from ..models.timing import Timing  # noqa: PLC0415

        d = dict(src_dict)

        def _parse_covariance(data: object) -> list[list[float]] | None:
            if data is None:
                return data
            try:
                if not isinstance(data, list):
                    raise TypeError()
                covariance_type_0 = []
                _covariance_type_0 = data
                for covariance_type_0_item_data in _covariance_type_0:
                    covariance_type_0_item = cast(list[float], covariance_type_0_item_data)

                    covariance_type_0.append(covariance_type_0_item)

                return covariance_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(list[list[float]] | None, data)

        covariance = _parse_covariance(d.pop("covariance"))

        created_at = datetime.datetime.fromisoformat(d.pop("created_at"))

        gain = d.pop("gain")

        handedness = Handedness(d.pop("handedness"))

        hypotheses = []
        _hypotheses = d.pop("hypotheses")
        for hypotheses_item_data in _hypotheses:
            hypotheses_item = Hypothesis.from_dict(hypotheses_item_data)

            hypotheses.append(hypotheses_item)

        id = d.pop("id")

        input_sha256 = d.pop("input_sha256")

        job_id = d.pop("job_id")

        offset = d.pop("offset")

        options = CalibrationOptions.from_dict(d.pop("options"))

        phantom = d.pop("phantom")

        phantom_id = d.pop("phantom_id")

        phantom_position_mm = []
        _phantom_position_mm = d.pop("phantom_position_mm")
        for phantom_position_mm_item_data in _phantom_position_mm:

            def _parse_phantom_position_mm_item(data: object) -> float:
                return cast(float, data)

            phantom_position_mm_item = _parse_phantom_position_mm_item(phantom_position_mm_item_data)

            phantom_position_mm.append(phantom_position_mm_item)

        def _parse_predicted_ray_error_mm(data: object) -> None | PredictedRayError:
            if data is None:
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                predicted_ray_error_mm_type_0 = PredictedRayError.from_dict(data)

                return predicted_ray_error_mm_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | PredictedRayError, data)

        predicted_ray_error_mm = _parse_predicted_ray_error_mm(d.pop("predicted_ray_error_mm"))

        reasons = cast(list[str], d.pop("reasons"))

        residual = Residual.from_dict(d.pop("residual"))

        rotation = Rotation(d.pop("rotation"))

        rows = []
        _rows = d.pop("rows")
        for rows_item_data in _rows:

            def _parse_rows_item(data: object) -> int:
                return cast(int, data)

            rows_item = _parse_rows_item(rows_item_data)

            rows.append(rows_item)

        scale_ray_error_mm = d.pop("scale_ray_error_mm")

        scale_uncertainty_mm = d.pop("scale_uncertainty_mm")

        scan_id = d.pop("scan_id")

        scanner = ScannerConstants.from_dict(d.pop("scanner"))

        scanner_id = d.pop("scanner_id")

        search = Search.from_dict(d.pop("search"))

        software_version = d.pop("software_version")

        source_frame = ReportedSourceFrame.from_dict(d.pop("source_frame"))

        def _parse_standard_deviation(data: object) -> None | StandardDeviation:
            if data is None:
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                standard_deviation_type_0 = StandardDeviation.from_dict(data)

                return standard_deviation_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | StandardDeviation, data)

        standard_deviation = _parse_standard_deviation(d.pop("standard_deviation"))

        state = cast(Literal["succeeded"], d.pop("state"))
        if state != "succeeded":
            raise ValueError(f"state must match const 'succeeded', got '{state}'")

        theta = Theta.from_dict(d.pop("theta"))

        def _parse_theta_twin(data: object) -> None | Theta:
            if data is None:
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                theta_twin_type_0 = Theta.from_dict(data)

                return theta_twin_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | Theta, data)

        theta_twin = _parse_theta_twin(d.pop("theta_twin"))

        timing_s = Timing.from_dict(d.pop("timing_s"))

        unconstrained_source_distance_mm = d.pop("unconstrained_source_distance_mm")

        verdict = Verdict(d.pop("verdict"))

        views = d.pop("views")

        adjustments = cast(list[str], d.pop("adjustments", UNSET))

        def _parse_answered_from(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        answered_from = _parse_answered_from(d.pop("answered_from", UNSET))

        def _parse_comparison(data: object) -> Comparison | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                comparison_type_0 = Comparison.from_dict(data)

                return comparison_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(Comparison | None | Unset, data)

        comparison = _parse_comparison(d.pop("comparison", UNSET))

        def _parse_limits(data: object) -> CalibrationLimits | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                limits_type_0 = CalibrationLimits.from_dict(data)

                return limits_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(CalibrationLimits | None | Unset, data)

        limits = _parse_limits(d.pop("limits", UNSET))

        def _parse_links(data: object) -> CalibrationLinks | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                links_type_0 = CalibrationLinks.from_dict(data)

                return links_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(CalibrationLinks | None | Unset, data)

        links = _parse_links(d.pop("links", UNSET))

        def _parse_rays_verdict(data: object) -> None | Unset | Verdict:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                rays_verdict_type_0 = Verdict(data)

                return rays_verdict_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | Unset | Verdict, data)

        rays_verdict = _parse_rays_verdict(d.pop("rays_verdict", UNSET))

        def _parse_scale_uncertainty_percent(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        scale_uncertainty_percent = _parse_scale_uncertainty_percent(d.pop("scale_uncertainty_percent", UNSET))

        def _parse_schedule_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        schedule_id = _parse_schedule_id(d.pop("schedule_id", UNSET))

        def _parse_second_witness(data: object) -> None | SecondWitness | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                second_witness_type_0 = SecondWitness.from_dict(data)

                return second_witness_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | SecondWitness | Unset, data)

        second_witness = _parse_second_witness(d.pop("second_witness", UNSET))

        def _parse_status(data: object) -> CalibrationStatus | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                status_type_0 = CalibrationStatus(data)

                return status_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(CalibrationStatus | None | Unset, data)

        status = _parse_status(d.pop("status", UNSET))

        def _parse_theta_covariance(data: object) -> list[list[float]] | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, list):
                    raise TypeError()
                theta_covariance_type_0 = []
                _theta_covariance_type_0 = data
                for theta_covariance_type_0_item_data in _theta_covariance_type_0:
                    theta_covariance_type_0_item = cast(list[float], theta_covariance_type_0_item_data)

                    theta_covariance_type_0.append(theta_covariance_type_0_item)

                return theta_covariance_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(list[list[float]] | None | Unset, data)

        theta_covariance = _parse_theta_covariance(d.pop("theta_covariance", UNSET))

        calibration_succeeded = cls(
            covariance=covariance,
            created_at=created_at,
            gain=gain,
            handedness=handedness,
            hypotheses=hypotheses,
            id=id,
            input_sha256=input_sha256,
            job_id=job_id,
            offset=offset,
            options=options,
            phantom=phantom,
            phantom_id=phantom_id,
            phantom_position_mm=phantom_position_mm,
            predicted_ray_error_mm=predicted_ray_error_mm,
            reasons=reasons,
            residual=residual,
            rotation=rotation,
            rows=rows,
            scale_ray_error_mm=scale_ray_error_mm,
            scale_uncertainty_mm=scale_uncertainty_mm,
            scan_id=scan_id,
            scanner=scanner,
            scanner_id=scanner_id,
            search=search,
            software_version=software_version,
            source_frame=source_frame,
            standard_deviation=standard_deviation,
            state=state,
            theta=theta,
            theta_twin=theta_twin,
            timing_s=timing_s,
            unconstrained_source_distance_mm=unconstrained_source_distance_mm,
            verdict=verdict,
            views=views,
            adjustments=adjustments,
            answered_from=answered_from,
            comparison=comparison,
            limits=limits,
            links=links,
            rays_verdict=rays_verdict,
            scale_uncertainty_percent=scale_uncertainty_percent,
            schedule_id=schedule_id,
            second_witness=second_witness,
            status=status,
            theta_covariance=theta_covariance,
        )

        return calibration_succeeded
