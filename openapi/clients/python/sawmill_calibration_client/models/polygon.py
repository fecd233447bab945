from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="Polygon")


@_attrs_define
class Polygon:
    """A closed polygon; its vertices may run either way round."""

    kind: Literal["polygon"]
    """ That it is a polygon. """
    vertices_mm: list[list[float]]
    """ (x, y) of each corner, mm. """
    density: float | Unset = 1.0
    """ Adds to what lies beneath, no unit: 1 is wood, -1 cuts a hole into wood. """

    def to_dict(self) -> dict[str, Any]:
        kind = self.kind

        vertices_mm = []
        for vertices_mm_item_data in self.vertices_mm:
            vertices_mm_item = []
            for vertices_mm_item_item_data in vertices_mm_item_data:
                vertices_mm_item_item: float
                vertices_mm_item_item = vertices_mm_item_item_data
                vertices_mm_item.append(vertices_mm_item_item)

            vertices_mm.append(vertices_mm_item)

        density = self.density

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "kind": kind,
                "vertices_mm": vertices_mm,
            }
        )
        if density is not UNSET:
            field_dict["density"] = density

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        kind = cast(Literal["polygon"], d.pop("kind"))
        if kind != "polygon":
            raise ValueError(f"kind must match const 'polygon', got '{kind}'")

        vertices_mm = []
        _vertices_mm = d.pop("vertices_mm")
        for vertices_mm_item_data in _vertices_mm:
            vertices_mm_item = []
            _vertices_mm_item = vertices_mm_item_data
            for vertices_mm_item_item_data in _vertices_mm_item:

                def _parse_vertices_mm_item_item(data: object) -> float:
                    return cast(float, data)

                vertices_mm_item_item = _parse_vertices_mm_item_item(vertices_mm_item_item_data)

                vertices_mm_item.append(vertices_mm_item_item)

            vertices_mm.append(vertices_mm_item)

        density = d.pop("density", UNSET)

        polygon = cls(
            kind=kind,
            vertices_mm=vertices_mm,
            density=density,
        )

        return polygon
