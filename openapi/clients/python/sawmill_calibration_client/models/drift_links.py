from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

T = TypeVar("T", bound="DriftLinks")


@_attrs_define
class DriftLinks:
    """Where it hangs together."""

    calibration: str
    """ Path of the calibration that it is compared with. """
    job: str
    """ Path of its job. """
    self_: str
    """ Its own path. """

    def to_dict(self) -> dict[str, Any]:
        calibration = self.calibration

        job = self.job

        self_ = self.self_

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "calibration": calibration,
                "job": job,
                "self": self_,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        calibration = d.pop("calibration")

        job = d.pop("job")

        self_ = d.pop("self")

        drift_links = cls(
            calibration=calibration,
            job=job,
            self_=self_,
        )

        return drift_links
