from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from attrs import define as _attrs_define

if TYPE_CHECKING:
    from ..models.source_frame_deviation import SourceFrameDeviation
    from ..models.theta_deviation import ThetaDeviation


T = TypeVar("T", bound="StandardDeviation")


@_attrs_define
class StandardDeviation:
    """Of theta and of the source frame."""

    source_frame: SourceFrameDeviation
    """ Standard deviations of the source frame; null for a parameter that was held fixed. """
    theta: ThetaDeviation
    """ Standard deviations of theta; null where the source shift is not resolved. """

    def to_dict(self) -> dict[str, Any]:
        source_frame = self.source_frame.to_dict()

        theta = self.theta.to_dict()

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "source_frame": source_frame,
                "theta": theta,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.source_frame_deviation import SourceFrameDeviation  # noqa: PLC0415
        from ..models.theta_deviation import ThetaDeviation  # noqa: PLC0415

        d = dict(src_dict)
        source_frame = SourceFrameDeviation.from_dict(d.pop("source_frame"))

        theta = ThetaDeviation.from_dict(d.pop("theta"))

        standard_deviation = cls(
            source_frame=source_frame,
            theta=theta,
        )

        return standard_deviation
