from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

from ..models.metal_treatment import MetalTreatment

T = TypeVar("T", bound="MetalReport")


@_attrs_define
class MetalReport:
    """Metal that was found in a log, and what was done about it."""

    samples: int
    """ Number of line integrals of these slices whose rays cross metal or pass beside it. """
    share_of_samples: float
    """ Their share of all line integrals of these slices, no unit. """
    slices: int
    """ Number of slices that show metal. """
    source: str
    """ The name of the method that deals with them, and where it was published. """
    treatment: MetalTreatment
    """ Rays through metal were interpolated along the detector, or left out of the fit. """

    def to_dict(self) -> dict[str, Any]:
        samples = self.samples

        share_of_samples = self.share_of_samples

        slices = self.slices

        source = self.source

        treatment = self.treatment.value

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "samples": samples,
                "share_of_samples": share_of_samples,
                "slices": slices,
                "source": source,
                "treatment": treatment,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        samples = d.pop("samples")

        share_of_samples = d.pop("share_of_samples")

        slices = d.pop("slices")

        source = d.pop("source")

        treatment = MetalTreatment(d.pop("treatment"))

        metal_report = cls(
            samples=samples,
            share_of_samples=share_of_samples,
            slices=slices,
            source=source,
            treatment=treatment,
        )

        return metal_report
