from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.reconstruction_method import ReconstructionMethod
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.metal_report import MetalReport


T = TypeVar("T", bound="MethodReport")


@_attrs_define
class MethodReport:
    """The method's parameters, and how well its slices explain the data. Of several slices, the median."""

    data_misfit: float | None
    """ RMS of the residual (A x - y), relative to the noise, no unit: near 1 for an iterative method with the right
    geometry, far above where the geometry is wrong. `fbp` does not fit the data: with the right geometry anything
    from 1 to 80, and a remark where it shows a wrong one. Null where the field does not hold all of the log. """
    name: ReconstructionMethod
    """ Filtered back-projection, the iterative methods, or whichever of them suits the scan's views and noise. """
    noise: float
    """ Standard deviation of a line integral, in its unit. """
    worst_data_misfit: float | None
    """ The largest `data_misfit` of all slices, no unit; for `fbp`, of five. Null with it. """
    alpha: float | None | Unset = UNSET
    """ Used by `tikhonov`, in mm². Null: another method. """
    beta: float | None | Unset = UNSET
    """ Used by `cauchy_map`, in the volume's unit. Null: another method. """
    coupling: float | None | Unset = UNSET
    """ Used by `total_variation`: the weight of a difference along the axis relative to one in the plane, no unit.
    0: each slice by itself. Null: another method. """
    expected_error: float | None | Unset = UNSET
    """ With `auto`: the relative error, no unit, of simulated logs from as many views, with as much noise. Null
    where the views do not go all round. """
    metal: MetalReport | None | Unset = UNSET
    """ Null: none was found, or it was not looked for. """
    reason: None | str | Unset = UNSET
    """ Why `auto` chose it. Null: `auto` was not asked for. """
    remarks: list[str] | Unset = UNSET
    """ What to know of the data and the fit. """
    sigma: float | None | Unset = UNSET
    """ Used by `cauchy_map`, in the unit of a line integral. Null: another method. """
    unconverged_slices: int | Unset = 0
    """ Number of slices that had not converged when the iterations ran out. """
    view_step: int | Unset = 1
    """ With `auto`: every view_step-th of the views was used. """
    weight: float | None | Unset = UNSET
    """ Used by `total_variation`, in 1 / attenuation. Null: another method. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.metal_report import MetalReport  # noqa: PLC0415

        data_misfit: float | None
        data_misfit = self.data_misfit

        name = self.name.value

        noise = self.noise

        worst_data_misfit: float | None
        worst_data_misfit = self.worst_data_misfit

        alpha: float | None | Unset
        if isinstance(self.alpha, Unset):
            alpha = UNSET
        else:
            alpha = self.alpha

        beta: float | None | Unset
        if isinstance(self.beta, Unset):
            beta = UNSET
        else:
            beta = self.beta

        coupling: float | None | Unset
        if isinstance(self.coupling, Unset):
            coupling = UNSET
        else:
            coupling = self.coupling

        expected_error: float | None | Unset
        if isinstance(self.expected_error, Unset):
            expected_error = UNSET
        else:
            expected_error = self.expected_error

        metal: dict[str, Any] | None | Unset
        if isinstance(self.metal, Unset):
            metal = UNSET
        elif isinstance(self.metal, MetalReport):
            metal = self.metal.to_dict()
        else:
            metal = self.metal

        reason: None | str | Unset
        if isinstance(self.reason, Unset):
            reason = UNSET
        else:
            reason = self.reason

        remarks: list[str] | Unset = UNSET
        if not isinstance(self.remarks, Unset):
            remarks = self.remarks

        sigma: float | None | Unset
        if isinstance(self.sigma, Unset):
            sigma = UNSET
        else:
            sigma = self.sigma

        unconverged_slices = self.unconverged_slices

        view_step = self.view_step

        weight: float | None | Unset
        if isinstance(self.weight, Unset):
            weight = UNSET
        else:
            weight = self.weight

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "data_misfit": data_misfit,
                "name": name,
                "noise": noise,
                "worst_data_misfit": worst_data_misfit,
            }
        )
        if alpha is not UNSET:
            field_dict["alpha"] = alpha
        if beta is not UNSET:
            field_dict["beta"] = beta
        if coupling is not UNSET:
            field_dict["coupling"] = coupling
        if expected_error is not UNSET:
            field_dict["expected_error"] = expected_error
        if metal is not UNSET:
            field_dict["metal"] = metal
        if reason is not UNSET:
            field_dict["reason"] = reason
        if remarks is not UNSET:
            field_dict["remarks"] = remarks
        if sigma is not UNSET:
            field_dict["sigma"] = sigma
        if unconverged_slices is not UNSET:
            field_dict["unconverged_slices"] = unconverged_slices
        if view_step is not UNSET:
            field_dict["view_step"] = view_step
        if weight is not UNSET:
            field_dict["weight"] = weight

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.metal_report import MetalReport  # noqa: PLC0415

        d = dict(src_dict)

        def _parse_data_misfit(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        data_misfit = _parse_data_misfit(d.pop("data_misfit"))

        name = ReconstructionMethod(d.pop("name"))

        noise = d.pop("noise")

        def _parse_worst_data_misfit(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        worst_data_misfit = _parse_worst_data_misfit(d.pop("worst_data_misfit"))

        def _parse_alpha(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        alpha = _parse_alpha(d.pop("alpha", UNSET))

        def _parse_beta(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        beta = _parse_beta(d.pop("beta", UNSET))

        def _parse_coupling(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        coupling = _parse_coupling(d.pop("coupling", UNSET))

        def _parse_expected_error(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        expected_error = _parse_expected_error(d.pop("expected_error", UNSET))

        def _parse_metal(data: object) -> MetalReport | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                metal_type_0 = MetalReport.from_dict(data)

                return metal_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(MetalReport | None | Unset, data)

        metal = _parse_metal(d.pop("metal", UNSET))

        def _parse_reason(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        reason = _parse_reason(d.pop("reason", UNSET))

        remarks = cast(list[str], d.pop("remarks", UNSET))

        def _parse_sigma(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        sigma = _parse_sigma(d.pop("sigma", UNSET))

        unconverged_slices = d.pop("unconverged_slices", UNSET)

        view_step = d.pop("view_step", UNSET)

        def _parse_weight(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        weight = _parse_weight(d.pop("weight", UNSET))

        method_report = cls(
            data_misfit=data_misfit,
            name=name,
            noise=noise,
            worst_data_misfit=worst_data_misfit,
            alpha=alpha,
            beta=beta,
            coupling=coupling,
            expected_error=expected_error,
            metal=metal,
            reason=reason,
            remarks=remarks,
            sigma=sigma,
            unconverged_slices=unconverged_slices,
            view_step=view_step,
            weight=weight,
        )

        return method_report
