from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

from ..models.readiness import Readiness

T = TypeVar("T", bound="Health")


@_attrs_define
class Health:
    """How the service is."""

    detail: str
    """ What is wrong, in one sentence; empty when nothing is. """
    state: Readiness
    """ Whether requests can be answered, and whether jobs are being done. """

    def to_dict(self) -> dict[str, Any]:
        detail = self.detail

        state = self.state.value

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "detail": detail,
                "state": state,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        detail = d.pop("detail")

        state = Readiness(d.pop("state"))

        health = cls(
            detail=detail,
            state=state,
        )

        return health
