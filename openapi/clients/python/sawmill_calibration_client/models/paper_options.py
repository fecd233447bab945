from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

from ..models.paper_correlation import PaperCorrelation
from ..models.paper_objective import PaperObjective
from ..models.paper_stop import PaperStop
from ..models.weighting import Weighting
from ..types import UNSET, Unset

T = TypeVar("T", bound="PaperOptions")


@_attrs_define
class PaperOptions:
    """Switches of the published search (arXiv 2206.14444)."""

    correlation: PaperCorrelation | Unset = UNSET
    """ Whether the published search's correlation is normed. """
    image_size: int | Unset = 256
    """ Pixels along each side of the correlated images. """
    max_generations: int | Unset = 1000
    """ The search ends after this number of generations. """
    objective: PaperObjective | Unset = UNSET
    """ What the published search compares. """
    stop: PaperStop | Unset = UNSET
    """ When the published search ends. """
    weighting: Weighting | Unset = UNSET
    """ exact: cosine and distance weights. none: neither, as published. """

    def to_dict(self) -> dict[str, Any]:
        correlation: str | Unset = UNSET
        if not isinstance(self.correlation, Unset):
            correlation = self.correlation.value

        image_size = self.image_size

        max_generations = self.max_generations

        objective: str | Unset = UNSET
        if not isinstance(self.objective, Unset):
            objective = self.objective.value

        stop: str | Unset = UNSET
        if not isinstance(self.stop, Unset):
            stop = self.stop.value

        weighting: str | Unset = UNSET
        if not isinstance(self.weighting, Unset):
            weighting = self.weighting.value

        field_dict: dict[str, Any] = {}

        field_dict.update({})
        if correlation is not UNSET:
            field_dict["correlation"] = correlation
        if image_size is not UNSET:
            field_dict["image_size"] = image_size
        if max_generations is not UNSET:
            field_dict["max_generations"] = max_generations
        if objective is not UNSET:
            field_dict["objective"] = objective
        if stop is not UNSET:
            field_dict["stop"] = stop
        if weighting is not UNSET:
            field_dict["weighting"] = weighting

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        _correlation = d.pop("correlation", UNSET)
        correlation: PaperCorrelation | Unset
        if isinstance(_correlation, Unset):
            correlation = UNSET
        else:
            correlation = PaperCorrelation(_correlation)

        image_size = d.pop("image_size", UNSET)

        max_generations = d.pop("max_generations", UNSET)

        _objective = d.pop("objective", UNSET)
        objective: PaperObjective | Unset
        if isinstance(_objective, Unset):
            objective = UNSET
        else:
            objective = PaperObjective(_objective)

        _stop = d.pop("stop", UNSET)
        stop: PaperStop | Unset
        if isinstance(_stop, Unset):
            stop = UNSET
        else:
            stop = PaperStop(_stop)

        _weighting = d.pop("weighting", UNSET)
        weighting: Weighting | Unset
        if isinstance(_weighting, Unset):
            weighting = UNSET
        else:
            weighting = Weighting(_weighting)

        paper_options = cls(
            correlation=correlation,
            image_size=image_size,
            max_generations=max_generations,
            objective=objective,
            stop=stop,
            weighting=weighting,
        )

        return paper_options
