from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

T = TypeVar("T", bound="InspectionLinks")


@_attrs_define
class InspectionLinks:
    """Where it hangs together."""

    job: str
    """ Path of its job. """
    self_: str
    """ Its own path. """

    def to_dict(self) -> dict[str, Any]:
        job = self.job

        self_ = self.self_

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "job": job,
                "self": self_,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        job = d.pop("job")

        self_ = d.pop("self")

        inspection_links = cls(
            job=job,
            self_=self_,
        )

        return inspection_links
