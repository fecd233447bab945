from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.predicted_ray_error import PredictedRayError
    from ..models.reported_source_frame import ReportedSourceFrame
    from ..models.scanner_constants import ScannerConstants
    from ..models.standard_deviation import StandardDeviation
    from ..models.theta import Theta


T = TypeVar("T", bound="PlanResult")


@_attrs_define
class PlanResult:
    """The precision to expect: the Cramér-Rao bound, with position, gain and background of the phantom unknown."""

    covariance: list[list[float]]
    """ Covariance of (psi, R, SDD, u_c, tau) in rad and mm, in the products of their units. """
    noise: float
    """ Standard deviation of the noise against the RMS of the phantom's sinogram, no unit. """
    noise_mm: float
    """ The noise's standard deviation, in mm of wood. """
    phantom: str
    """ The phantom's name. """
    predicted_ray_error_mm: PredictedRayError
    """ The ray error that the covariance predicts, inside the log's disc. """
    scale_ray_error_mm: float
    """ RMS ray error from the phantom's size tolerance. In mm. """
    scale_uncertainty_mm: float
    """ What R inherits from the phantom's size tolerance beside it. In mm. """
    scanner: ScannerConstants
    """ What is known of a scanner without calibrating it. """
    software_version: str
    """ Version of the software that computed it. """
    source_frame: ReportedSourceFrame
    """ The geometry with the source on the axis, what the data can see, with its magnification. """
    standard_deviation: StandardDeviation
    """ Of theta and of the source frame. """
    theta: Theta
    """ The five numbers that cannot be measured by hand: theta = (alpha0, r_D, h_S, h_D, alpha_D). """
    views: int
    """ Number of views that are planned. """
    views_cut_off: int
    """ Number of views whose shadow reaches an end of the detector; 0 is right. """
    scale_uncertainty_percent: float | None | Unset = UNSET
    """ The image's millimetres will be right to this with 95 %: from the size tolerance and the noise of R/SDD.
    Null: a plan of an earlier version. """

    def to_dict(self) -> dict[str, Any]:
        covariance = []
        for covariance_item_data in self.covariance:
            covariance_item = covariance_item_data

            covariance.append(covariance_item)

        noise = self.noise

        noise_mm = self.noise_mm

        phantom = self.phantom

        predicted_ray_error_mm = self.predicted_ray_error_mm.to_dict()

        scale_ray_error_mm = self.scale_ray_error_mm

        scale_uncertainty_mm = self.scale_uncertainty_mm

        scanner = self.scanner.to_dict()

        software_version = self.software_version

        source_frame = self.source_frame.to_dict()

        standard_deviation = self.standard_deviation.to_dict()

        theta = self.theta.to_dict()

        views = self.views

        views_cut_off = self.views_cut_off

        scale_uncertainty_percent: float | None | Unset
        if isinstance(self.scale_uncertainty_percent, Unset):
            scale_uncertainty_percent = UNSET
        else:
            scale_uncertainty_percent = self.scale_uncertainty_percent

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "covariance": covariance,
                "noise": noise,
                "noise_mm": noise_mm,
                "phantom": phantom,
                "predicted_ray_error_mm": predicted_ray_error_mm,
                "scale_ray_error_mm": scale_ray_error_mm,
                "scale_uncertainty_mm": scale_uncertainty_mm,
                "scanner": scanner,
                "software_version": software_version,
                "source_frame": source_frame,
                "standard_deviation": standard_deviation,
                "theta": theta,
                "views": views,
                "views_cut_off": views_cut_off,
            }
        )
        if scale_uncertainty_percent is not UNSET:
            field_dict["scale_uncertainty_percent"] = scale_uncertainty_percent

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.predicted_ray_error import PredictedRayError  # noqa: PLC0415
        from ..models.reported_source_frame import ReportedSourceFrame  # noqa: PLC0415
        from ..models.scanner_constants import ScannerConstants  # noqa: PLC0415
        from ..models.standard_deviation import StandardDeviation  # noqa: PLC0415
        from ..models.theta import Theta  # noqa: PLC0415

        d = dict(src_dict)
        covariance = []
        _covariance = d.pop("covariance")
        for covariance_item_data in _covariance:
            covariance_item = cast(list[float], covariance_item_data)

            covariance.append(covariance_item)

        noise = d.pop("noise")

        noise_mm = d.pop("noise_mm")

        phantom = d.pop("phantom")

        predicted_ray_error_mm = PredictedRayError.from_dict(d.pop("predicted_ray_error_mm"))

        scale_ray_error_mm = d.pop("scale_ray_error_mm")

        scale_uncertainty_mm = d.pop("scale_uncertainty_mm")

        scanner = ScannerConstants.from_dict(d.pop("scanner"))

        software_version = d.pop("software_version")

        source_frame = ReportedSourceFrame.from_dict(d.pop("source_frame"))

        standard_deviation = StandardDeviation.from_dict(d.pop("standard_deviation"))

        theta = Theta.from_dict(d.pop("theta"))

        views = d.pop("views")

        views_cut_off = d.pop("views_cut_off")

        def _parse_scale_uncertainty_percent(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        scale_uncertainty_percent = _parse_scale_uncertainty_percent(d.pop("scale_uncertainty_percent", UNSET))

        plan_result = cls(
            covariance=covariance,
            noise=noise,
            noise_mm=noise_mm,
            phantom=phantom,
            predicted_ray_error_mm=predicted_ray_error_mm,
            scale_ray_error_mm=scale_ray_error_mm,
            scale_uncertainty_mm=scale_uncertainty_mm,
            scanner=scanner,
            software_version=software_version,
            source_frame=source_frame,
            standard_deviation=standard_deviation,
            theta=theta,
            views=views,
            views_cut_off=views_cut_off,
            scale_uncertainty_percent=scale_uncertainty_percent,
        )

        return plan_result
