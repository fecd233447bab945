from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

T = TypeVar("T", bound="Timing")


@_attrs_define
class Timing:
    """Seconds; total runs from the sinogram in memory to the complete answer."""

    refine: float
    """ Seconds of the refinement. """
    search: float
    """ Seconds of the search. """
    total: float
    """ Seconds of all together. """
    uncertainty: float
    """ Seconds of the error bars. """

    def to_dict(self) -> dict[str, Any]:
        refine = self.refine

        search = self.search

        total = self.total

        uncertainty = self.uncertainty

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "refine": refine,
                "search": search,
                "total": total,
                "uncertainty": uncertainty,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        refine = d.pop("refine")

        search = d.pop("search")

        total = d.pop("total")

        uncertainty = d.pop("uncertainty")

        timing = cls(
            refine=refine,
            search=search,
            total=total,
            uncertainty=uncertainty,
        )

        return timing
