from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="Disc")


@_attrs_define
class Disc:
    """A disc."""

    center_mm: list[float]
    """ (x, y) of the centre, mm. """
    kind: Literal["disc"]
    """ That it is a disc. """
    radius_mm: float
    """ Radius, mm. """
    density: float | Unset = 1.0
    """ Adds to what lies beneath, no unit: 1 is wood, -1 cuts a hole into wood. """

    def to_dict(self) -> dict[str, Any]:
        center_mm = []
        for center_mm_item_data in self.center_mm:
            center_mm_item: float
            center_mm_item = center_mm_item_data
            center_mm.append(center_mm_item)

        kind = self.kind

        radius_mm = self.radius_mm

        density = self.density

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "center_mm": center_mm,
                "kind": kind,
                "radius_mm": radius_mm,
            }
        )
        if density is not UNSET:
            field_dict["density"] = density

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        center_mm = []
        _center_mm = d.pop("center_mm")
        for center_mm_item_data in _center_mm:

            def _parse_center_mm_item(data: object) -> float:
                return cast(float, data)

            center_mm_item = _parse_center_mm_item(center_mm_item_data)

            center_mm.append(center_mm_item)

        kind = cast(Literal["disc"], d.pop("kind"))
        if kind != "disc":
            raise ValueError(f"kind must match const 'disc', got '{kind}'")

        radius_mm = d.pop("radius_mm")

        density = d.pop("density", UNSET)

        disc = cls(
            center_mm=center_mm,
            kind=kind,
            radius_mm=radius_mm,
            density=density,
        )

        return disc
