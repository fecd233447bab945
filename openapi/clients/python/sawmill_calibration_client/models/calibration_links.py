from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

T = TypeVar("T", bound="CalibrationLinks")


@_attrs_define
class CalibrationLinks:
    """Where its files are."""

    hdf5: str
    """ Path of the HDF5 file with every number and array. """
    job: str
    """ Path of its job. """
    overlay: str
    """ Path of the picture of the phantom with its outline. """
    report: str
    """ Path of the report picture. """
    self_: str
    """ Its own path. """

    def to_dict(self) -> dict[str, Any]:
        hdf5 = self.hdf5

        job = self.job

        overlay = self.overlay

        report = self.report

        self_ = self.self_

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "hdf5": hdf5,
                "job": job,
                "overlay": overlay,
                "report": report,
                "self": self_,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        hdf5 = d.pop("hdf5")

        job = d.pop("job")

        overlay = d.pop("overlay")

        report = d.pop("report")

        self_ = d.pop("self")

        calibration_links = cls(
            hdf5=hdf5,
            job=job,
            overlay=overlay,
            report=report,
            self_=self_,
        )

        return calibration_links
