from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

T = TypeVar("T", bound="Residual")


@_attrs_define
class Residual:
    """What the model leaves of the sinogram."""

    relative: float
    """ RMS of the residual against that of the background-free sinogram, no unit. """
    rms: float
    """ In the unit of the sinogram. """

    def to_dict(self) -> dict[str, Any]:
        relative = self.relative

        rms = self.rms

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "relative": relative,
                "rms": rms,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        relative = d.pop("relative")

        rms = d.pop("rms")

        residual = cls(
            relative=relative,
            rms=rms,
        )

        return residual
