from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast

from attrs import define as _attrs_define

from ..models.alpha_rule import AlphaRule
from ..models.filter_name import FilterName
from ..models.handedness import Handedness
from ..models.metal_handling import MetalHandling
from ..models.preference import Preference
from ..models.reconstruction_method import ReconstructionMethod
from ..models.rotation import Rotation
from ..models.weighting import Weighting
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.theta import Theta


T = TypeVar("T", bound="ReconstructionAsked")


@_attrs_define
class ReconstructionAsked:
    """A request as it is stored: an earlier version accepted values that `ReconstructionAsk` refuses."""

    scan_id: str
    """ Id of the scan to reconstruct. """
    alpha: float | None | Unset = UNSET
    """ Of `tikhonov`: regularisation weight, in mm². By default chosen by alpha_rule. """
    alpha_rule: AlphaRule | Unset = UNSET
    """ How Tikhonov's alpha is chosen where it is not given.

    cross-validation: the alpha whose image predicts views that were left out best (Stone 1974). discrepancy: the
    largest alpha that explains the data to their noise (Morozov). gcv: generalised cross-validation (Golub, Heath
    and Wahba 1979). l-curve: where residual against norm bends most sharply (Hansen 1992). """
    beta: float | None | Unset = UNSET
    """ Of `cauchy_map`: scale of the differences between neighbouring pixels, in the volume's unit. By default
    chosen with sigma, or a usual share of the wood's attenuation where sigma is given. """
    calibration_id: None | str | Unset = UNSET
    """ Null: the scanner's active calibration, unless theta is given. """
    coupling: str | Unset = "auto"
    """ Of `total_variation`: how neighbouring slices help each other. `auto` chooses it, and whether at all, by
    cross-validation on slices in the middle. `none`: each slice by itself. A number is the weight of a difference
    along the axis relative to one in the plane, no unit, below 100. """
    field_centre_mm: list[float] | Unset = UNSET
    """ (x, y) of the field's centre; that of a region of interest is not the rotation centre. In mm. """
    field_mm: float | Unset = 400.0
    """ Side of the square field. In mm. """
    filter_: FilterName | Unset = UNSET
    """ Window on the ramp. """
    frequency_scaling: float | Unset = 1.0
    """ Cut-off as a fraction of the Nyquist frequency, no unit. """
    handedness: Handedness | None | Unset = UNSET
    """ With theta: recorded in the result. """
    metal: MetalHandling | Unset = UNSET
    """ What becomes of rays through metal in a log.

    `auto` leaves them out where a method can do without rays, and interpolates them for the others. `interpolate`
    does
    so for every method. `none` takes them as they are. """
    method: ReconstructionMethod | Unset = UNSET
    """ Filtered back-projection, the iterative methods, or whichever of them suits the scan's views and noise. """
    non_negative: bool | Unset = True
    """ Of `cauchy_map` and `total_variation`: no attenuation below zero. """
    prefer: Preference | Unset = UNSET
    """ What `auto` goes by.

    quality: the lowest expected error within a price in time. speed: filtered back-projection wherever views
    suffice. """
    preset: Literal["paper"] | None | Unset = UNSET
    """ Of `cauchy_map`: the published settings (arXiv 2206.14444), instead of sigma and beta. """
    rotation: None | Rotation | Unset = UNSET
    """ With theta: which way the angles count. """
    rows: None | str | Unset = UNSET
    """ Detector rows to reconstruct, one slice each: A:B, the first included, the last not, or every STEP-th of
    them, A:B[:STEP]. By default all. """
    sigma: float | None | Unset = UNSET
    """ Of `cauchy_map`: standard deviation of a line integral, in its unit. By default a multiple of the noise in
    air, chosen by tuning on a synthetic scan of the same log. """
    size: int | Unset = 256
    """ Pixels along each side. """
    theta: None | Theta | Unset = UNSET
    """ A geometry of your own, instead of a calibration. """
    uncertainty: bool | Unset = False
    """ Ignored, with a remark: each pixel's standard deviation is no longer computed. """
    views: int | None | Unset = UNSET
    """ Number of views to use: every (total / views)-th, each with its own angle. By default all. """
    weight: float | None | Unset = UNSET
    """ Of `total_variation`, in 1 / attenuation. By default chosen by cross-validation. """
    weighting: Weighting | Unset = UNSET
    """ exact: cosine and distance weights. none: neither, as published. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.theta import Theta  # noqa: PLC0415

        scan_id = self.scan_id

        alpha: float | None | Unset
        if isinstance(self.alpha, Unset):
            alpha = UNSET
        else:
            alpha = self.alpha

        alpha_rule: str | Unset = UNSET
        if not isinstance(self.alpha_rule, Unset):
            alpha_rule = self.alpha_rule.value

        beta: float | None | Unset
        if isinstance(self.beta, Unset):
            beta = UNSET
        else:
            beta = self.beta

        calibration_id: None | str | Unset
        if isinstance(self.calibration_id, Unset):
            calibration_id = UNSET
        else:
            calibration_id = self.calibration_id

        coupling = self.coupling

        field_centre_mm: list[float] | Unset = UNSET
        if not isinstance(self.field_centre_mm, Unset):
            field_centre_mm = []
            for field_centre_mm_item_data in self.field_centre_mm:
                field_centre_mm_item: float
                field_centre_mm_item = field_centre_mm_item_data
                field_centre_mm.append(field_centre_mm_item)

        field_mm = self.field_mm

        filter_: str | Unset = UNSET
        if not isinstance(self.filter_, Unset):
            filter_ = self.filter_.value

        frequency_scaling = self.frequency_scaling

        handedness: None | str | Unset
        if isinstance(self.handedness, Unset):
            handedness = UNSET
        elif isinstance(self.handedness, Handedness):
            handedness = self.handedness.value
        else:
            handedness = self.handedness

        metal: str | Unset = UNSET
        if not isinstance(self.metal, Unset):
            metal = self.metal.value

        method: str | Unset = UNSET
        if not isinstance(self.method, Unset):
            method = self.method.value

        non_negative = self.non_negative

        prefer: str | Unset = UNSET
        if not isinstance(self.prefer, Unset):
            prefer = self.prefer.value

        preset: Literal["paper"] | None | Unset
        if isinstance(self.preset, Unset):
            preset = UNSET
        else:
            preset = self.preset

        rotation: None | str | Unset
        if isinstance(self.rotation, Unset):
            rotation = UNSET
        elif isinstance(self.rotation, Rotation):
            rotation = self.rotation.value
        else:
            rotation = self.rotation

        rows: None | str | Unset
        if isinstance(self.rows, Unset):
            rows = UNSET
        else:
            rows = self.rows

        sigma: float | None | Unset
        if isinstance(self.sigma, Unset):
            sigma = UNSET
        else:
            sigma = self.sigma

        size = self.size

        theta: dict[str, Any] | None | Unset
        if isinstance(self.theta, Unset):
            theta = UNSET
        elif isinstance(self.theta, Theta):
            theta = self.theta.to_dict()
        else:
            theta = self.theta

        uncertainty = self.uncertainty

        views: int | None | Unset
        if isinstance(self.views, Unset):
            views = UNSET
        else:
            views = self.views

        weight: float | None | Unset
        if isinstance(self.weight, Unset):
            weight = UNSET
        else:
            weight = self.weight

        weighting: str | Unset = UNSET
        if not isinstance(self.weighting, Unset):
            weighting = self.weighting.value

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "scan_id": scan_id,
            }
        )
        if alpha is not UNSET:
            field_dict["alpha"] = alpha
        if alpha_rule is not UNSET:
            field_dict["alpha_rule"] = alpha_rule
        if beta is not UNSET:
            field_dict["beta"] = beta
        if calibration_id is not UNSET:
            field_dict["calibration_id"] = calibration_id
        if coupling is not UNSET:
            field_dict["coupling"] = coupling
        if field_centre_mm is not UNSET:
            field_dict["field_centre_mm"] = field_centre_mm
        if field_mm is not UNSET:
            field_dict["field_mm"] = field_mm
        if filter_ is not UNSET:
            field_dict["filter"] = filter_
        if frequency_scaling is not UNSET:
            field_dict["frequency_scaling"] = frequency_scaling
        if handedness is not UNSET:
            field_dict["handedness"] = handedness
        if metal is not UNSET:
            field_dict["metal"] = metal
        if method is not UNSET:
            field_dict["method"] = method
        if non_negative is not UNSET:
            field_dict["non_negative"] = non_negative
        if prefer is not UNSET:
            field_dict["prefer"] = prefer
        if preset is not UNSET:
            field_dict["preset"] = preset
        if rotation is not UNSET:
            field_dict["rotation"] = rotation
        if rows is not UNSET:
            field_dict["rows"] = rows
        if sigma is not UNSET:
            field_dict["sigma"] = sigma
        if size is not UNSET:
            field_dict["size"] = size
        if theta is not UNSET:
            field_dict["theta"] = theta
        if uncertainty is not UNSET:
            field_dict["uncertainty"] = uncertainty
        if views is not UNSET:
            field_dict["views"] = views
        if weight is not UNSET:
            field_dict["weight"] = weight
        if weighting is not UNSET:
            field_dict["weighting"] = weighting

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.theta import Theta  # noqa: PLC0415

        d = dict(src_dict)
        scan_id = d.pop("scan_id")

        def _parse_alpha(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        alpha = _parse_alpha(d.pop("alpha", UNSET))

        _alpha_rule = d.pop("alpha_rule", UNSET)
        alpha_rule: AlphaRule | Unset
        if isinstance(_alpha_rule, Unset):
            alpha_rule = UNSET
        else:
            alpha_rule = AlphaRule(_alpha_rule)

        def _parse_beta(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        beta = _parse_beta(d.pop("beta", UNSET))

        def _parse_calibration_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        calibration_id = _parse_calibration_id(d.pop("calibration_id", UNSET))

        coupling = d.pop("coupling", UNSET)

        _field_centre_mm = d.pop("field_centre_mm", UNSET)
        field_centre_mm: list[float] | Unset = UNSET
        if _field_centre_mm is not UNSET:
            field_centre_mm = []
            for field_centre_mm_item_data in _field_centre_mm:

                def _parse_field_centre_mm_item(data: object) -> float:
                    return cast(float, data)

                field_centre_mm_item = _parse_field_centre_mm_item(field_centre_mm_item_data)

                field_centre_mm.append(field_centre_mm_item)

        field_mm = d.pop("field_mm", UNSET)

        _filter_ = d.pop("filter", UNSET)
        filter_: FilterName | Unset
        if isinstance(_filter_, Unset):
            filter_ = UNSET
        else:
            filter_ = FilterName(_filter_)

        frequency_scaling = d.pop("frequency_scaling", UNSET)

        def _parse_handedness(data: object) -> Handedness | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                handedness_type_0 = Handedness(data)

                return handedness_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(Handedness | None | Unset, data)

        handedness = _parse_handedness(d.pop("handedness", UNSET))

        _metal = d.pop("metal", UNSET)
        metal: MetalHandling | Unset
        if isinstance(_metal, Unset):
            metal = UNSET
        else:
            metal = MetalHandling(_metal)

        _method = d.pop("method", UNSET)
        method: ReconstructionMethod | Unset
        if isinstance(_method, Unset):
            method = UNSET
        else:
            method = ReconstructionMethod(_method)

        non_negative = d.pop("non_negative", UNSET)

        _prefer = d.pop("prefer", UNSET)
        prefer: Preference | Unset
        if isinstance(_prefer, Unset):
            prefer = UNSET
        else:
            prefer = Preference(_prefer)

        def _parse_preset(data: object) -> Literal["paper"] | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            preset_type_0 = cast(Literal["paper"], data)
            if preset_type_0 != "paper":
                raise ValueError(f"preset_type_0 must match const 'paper', got '{preset_type_0}'")
            return preset_type_0
            return cast(Literal["paper"] | None | Unset, data)

        preset = _parse_preset(d.pop("preset", UNSET))

        def _parse_rotation(data: object) -> None | Rotation | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                rotation_type_0 = Rotation(data)

                return rotation_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | Rotation | Unset, data)

        rotation = _parse_rotation(d.pop("rotation", UNSET))

        def _parse_rows(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        rows = _parse_rows(d.pop("rows", UNSET))

        def _parse_sigma(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        sigma = _parse_sigma(d.pop("sigma", UNSET))

        size = d.pop("size", UNSET)

        def _parse_theta(data: object) -> None | Theta | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                theta_type_0 = Theta.from_dict(data)

                return theta_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | Theta | Unset, data)

        theta = _parse_theta(d.pop("theta", UNSET))

        uncertainty = d.pop("uncertainty", UNSET)

        def _parse_views(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        views = _parse_views(d.pop("views", UNSET))

        def _parse_weight(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        weight = _parse_weight(d.pop("weight", UNSET))

        _weighting = d.pop("weighting", UNSET)
        weighting: Weighting | Unset
        if isinstance(_weighting, Unset):
            weighting = UNSET
        else:
            weighting = Weighting(_weighting)

        reconstruction_asked = cls(
            scan_id=scan_id,
            alpha=alpha,
            alpha_rule=alpha_rule,
            beta=beta,
            calibration_id=calibration_id,
            coupling=coupling,
            field_centre_mm=field_centre_mm,
            field_mm=field_mm,
            filter_=filter_,
            frequency_scaling=frequency_scaling,
            handedness=handedness,
            metal=metal,
            method=method,
            non_negative=non_negative,
            prefer=prefer,
            preset=preset,
            rotation=rotation,
            rows=rows,
            sigma=sigma,
            size=size,
            theta=theta,
            uncertainty=uncertainty,
            views=views,
            weight=weight,
            weighting=weighting,
        )

        return reconstruction_asked
