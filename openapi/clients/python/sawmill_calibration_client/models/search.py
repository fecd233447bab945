from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

T = TypeVar("T", bound="Search")


@_attrs_define
class Search:
    """How the basin was found."""

    best_value: float
    """ The objective at the best geometry, in the objective's own unit. """
    converged: bool
    """ Whether the search converged. """
    evaluations: int
    """ Number of times that the objective was computed. """
    generations: int
    """ Number of generations of the search. """
    message: str
    """ How the search ended, in words. """
    method: str
    """ The search's name. """
    seed: int
    """ Seed of the search's random numbers, no unit. """

    def to_dict(self) -> dict[str, Any]:
        best_value = self.best_value

        converged = self.converged

        evaluations = self.evaluations

        generations = self.generations

        message = self.message

        method = self.method

        seed = self.seed

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "best_value": best_value,
                "converged": converged,
                "evaluations": evaluations,
                "generations": generations,
                "message": message,
                "method": method,
                "seed": seed,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        best_value = d.pop("best_value")

        converged = d.pop("converged")

        evaluations = d.pop("evaluations")

        generations = d.pop("generations")

        message = d.pop("message")

        method = d.pop("method")

        seed = d.pop("seed")

        search = cls(
            best_value=best_value,
            converged=converged,
            evaluations=evaluations,
            generations=generations,
            message=message,
            method=method,
            seed=seed,
        )

        return search
