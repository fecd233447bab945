from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.given_theta import GivenTheta


T = TypeVar("T", bound="PlanAsk")


@_attrs_define
class PlanAsk:
    """Ask what precision a phantom will give on a scanner."""

    scanner_id: str
    """ Id of the scanner that is to be calibrated. """
    fresh: bool | Unset = False
    """ Compute it even where the same was computed before, of the same input, with the same parameters and the same
    version of the software. Otherwise that result answers at once, and `answered_from` names it. """
    noise: float | Unset = 0.02
    """ Standard deviation of the noise against the RMS of the phantom's sinogram, no unit. """
    size_tolerance_percent: float | None | Unset = UNSET
    """ Relative standard uncertainty of the phantom's size, in per cent. By default its drawing's. """
    theta: GivenTheta | None | Unset = UNSET
    """ The nominal geometry; null: that of the scanner's active calibration. """
    views: int | Unset = 360
    """ Number of views, equidistant over a full turn. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.given_theta import GivenTheta  # noqa: PLC0415

        scanner_id = self.scanner_id

        fresh = self.fresh

        noise = self.noise

        size_tolerance_percent: float | None | Unset
        if isinstance(self.size_tolerance_percent, Unset):
            size_tolerance_percent = UNSET
        else:
            size_tolerance_percent = self.size_tolerance_percent

        theta: dict[str, Any] | None | Unset
        if isinstance(self.theta, Unset):
            theta = UNSET
        elif isinstance(self.theta, GivenTheta):
            theta = self.theta.to_dict()
        else:
            theta = self.theta

        views = self.views

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "scanner_id": scanner_id,
            }
        )
        if fresh is not UNSET:
            field_dict["fresh"] = fresh
        if noise is not UNSET:
            field_dict["noise"] = noise
        if size_tolerance_percent is not UNSET:
            field_dict["size_tolerance_percent"] = size_tolerance_percent
        if theta is not UNSET:
            field_dict["theta"] = theta
        if views is not UNSET:
            field_dict["views"] = views

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.given_theta import GivenTheta  # noqa: PLC0415

        d = dict(src_dict)
        scanner_id = d.pop("scanner_id")

        fresh = d.pop("fresh", UNSET)

        noise = d.pop("noise", UNSET)

        def _parse_size_tolerance_percent(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        size_tolerance_percent = _parse_size_tolerance_percent(d.pop("size_tolerance_percent", UNSET))

        def _parse_theta(data: object) -> GivenTheta | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                theta_type_0 = GivenTheta.from_dict(data)

                return theta_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(GivenTheta | None | Unset, data)

        theta = _parse_theta(d.pop("theta", UNSET))

        views = d.pop("views", UNSET)

        plan_ask = cls(
            scanner_id=scanner_id,
            fresh=fresh,
            noise=noise,
            size_tolerance_percent=size_tolerance_percent,
            theta=theta,
            views=views,
        )

        return plan_ask
