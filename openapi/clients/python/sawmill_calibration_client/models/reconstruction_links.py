from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

T = TypeVar("T", bound="ReconstructionLinks")


@_attrs_define
class ReconstructionLinks:
    """Links to its files."""

    first_slice: str
    """ Path of the picture of the first slice. """
    first_slice_array: str
    """ Path of the first slice as an array. """
    job: str
    """ Path of its job. """
    mosaic: str
    """ Path of the picture of slices along the log. """
    self_: str
    """ Its own path. """
    side: str
    """ Path of the picture of the log from the side. """
    side_array: str
    """ Path of the side view as an array. """
    thumbnail: str
    """ Path of the small picture. """
    volume: str
    """ Path of the volume as HDF5. """

    def to_dict(self) -> dict[str, Any]:
        first_slice = self.first_slice

        first_slice_array = self.first_slice_array

        job = self.job

        mosaic = self.mosaic

        self_ = self.self_

        side = self.side

        side_array = self.side_array

        thumbnail = self.thumbnail

        volume = self.volume

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "first_slice": first_slice,
                "first_slice_array": first_slice_array,
                "job": job,
                "mosaic": mosaic,
                "self": self_,
                "side": side,
                "side_array": side_array,
                "thumbnail": thumbnail,
                "volume": volume,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        first_slice = d.pop("first_slice")

        first_slice_array = d.pop("first_slice_array")

        job = d.pop("job")

        mosaic = d.pop("mosaic")

        self_ = d.pop("self")

        side = d.pop("side")

        side_array = d.pop("side_array")

        thumbnail = d.pop("thumbnail")

        volume = d.pop("volume")

        reconstruction_links = cls(
            first_slice=first_slice,
            first_slice_array=first_slice_array,
            job=job,
            mosaic=mosaic,
            self_=self_,
            side=side,
            side_array=side_array,
            thumbnail=thumbnail,
            volume=volume,
        )

        return reconstruction_links
