from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="Progress")


@_attrs_define
class Progress:
    """How far a running job is."""

    fraction: float
    """ Share that is done, no unit. """
    stage: str
    """ What it does now. """
    best_value: float | None | Unset = UNSET
    """ Best objective of the search so far, in its own unit. Null: there is none. """
    generation: int | None | Unset = UNSET
    """ Number of the search's generation. Null: it has none. """
    seconds_left: float | None | Unset = UNSET
    """ Seconds until a reconstruction ends, by its pace so far. Null: not known. """

    def to_dict(self) -> dict[str, Any]:
        fraction = self.fraction

        stage = self.stage

        best_value: float | None | Unset
        if isinstance(self.best_value, Unset):
            best_value = UNSET
        else:
            best_value = self.best_value

        generation: int | None | Unset
        if isinstance(self.generation, Unset):
            generation = UNSET
        else:
            generation = self.generation

        seconds_left: float | None | Unset
        if isinstance(self.seconds_left, Unset):
            seconds_left = UNSET
        else:
            seconds_left = self.seconds_left

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "fraction": fraction,
                "stage": stage,
            }
        )
        if best_value is not UNSET:
            field_dict["best_value"] = best_value
        if generation is not UNSET:
            field_dict["generation"] = generation
        if seconds_left is not UNSET:
            field_dict["seconds_left"] = seconds_left

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        fraction = d.pop("fraction")

        stage = d.pop("stage")

        def _parse_best_value(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        best_value = _parse_best_value(d.pop("best_value", UNSET))

        def _parse_generation(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        generation = _parse_generation(d.pop("generation", UNSET))

        def _parse_seconds_left(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        seconds_left = _parse_seconds_left(d.pop("seconds_left", UNSET))

        progress = cls(
            fraction=fraction,
            stage=stage,
            best_value=best_value,
            generation=generation,
            seconds_left=seconds_left,
        )

        return progress
