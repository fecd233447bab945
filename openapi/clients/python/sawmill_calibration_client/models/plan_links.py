from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

T = TypeVar("T", bound="PlanLinks")


@_attrs_define
class PlanLinks:
    """Where it hangs together."""

    job: str
    """ Path of its job. """
    phantom: str
    """ Path of the phantom. """
    self_: str
    """ Its own path. """

    def to_dict(self) -> dict[str, Any]:
        job = self.job

        phantom = self.phantom

        self_ = self.self_

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "job": job,
                "phantom": phantom,
                "self": self_,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        job = d.pop("job")

        phantom = d.pop("phantom")

        self_ = d.pop("self")

        plan_links = cls(
            job=job,
            phantom=phantom,
            self_=self_,
        )

        return plan_links
