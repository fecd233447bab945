from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.handedness import Handedness
from ..models.rotation import Rotation
from ..types import UNSET, Unset

T = TypeVar("T", bound="Hypothesis")


@_attrs_define
class Hypothesis:
    """One of the four: handedness and sense of rotation."""

    handedness: Handedness
    """ From which end the phantom was looked at: as drawn, or from behind (y becomes -y). """
    relative_residual: float
    """ RMS of the residual against that of the background-free sinogram, no unit. """
    rotation: Rotation
    """ Which way the view angles count: as the scan gives them, or the other way (phi becomes -phi). """
    log_likelihood_behind: float | None | Unset = UNSET
    """ How far its logarithmic likelihood is behind the best one's, no unit; below 10 the scan does not decide.
    Null without error bars. """

    def to_dict(self) -> dict[str, Any]:
        handedness = self.handedness.value

        relative_residual = self.relative_residual

        rotation = self.rotation.value

        log_likelihood_behind: float | None | Unset
        if isinstance(self.log_likelihood_behind, Unset):
            log_likelihood_behind = UNSET
        else:
            log_likelihood_behind = self.log_likelihood_behind

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "handedness": handedness,
                "relative_residual": relative_residual,
                "rotation": rotation,
            }
        )
        if log_likelihood_behind is not UNSET:
            field_dict["log_likelihood_behind"] = log_likelihood_behind

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        handedness = Handedness(d.pop("handedness"))

        relative_residual = d.pop("relative_residual")

        rotation = Rotation(d.pop("rotation"))

        def _parse_log_likelihood_behind(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        log_likelihood_behind = _parse_log_likelihood_behind(d.pop("log_likelihood_behind", UNSET))

        hypothesis = cls(
            handedness=handedness,
            relative_residual=relative_residual,
            rotation=rotation,
            log_likelihood_behind=log_likelihood_behind,
        )

        return hypothesis
