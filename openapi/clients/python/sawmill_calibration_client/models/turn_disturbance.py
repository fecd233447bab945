from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.disturbed_part import DisturbedPart
from ..types import UNSET, Unset

T = TypeVar("T", bound="TurnDisturbance")


@_attrs_define
class TurnDisturbance:
    """A harmonic of the turn itself, fitted with the geometry: it is neither drift nor part of the change."""

    part: DisturbedPart
    """ encoder: the angles run ahead and behind. bearing: the log swings across the beam. """
    times_a_turn: int
    """ Number of its periods a turn. """
    amplitude_deg: float | None | Unset = UNSET
    """ Of the encoder. In degrees. """
    amplitude_mm: float | None | Unset = UNSET
    """ Of the bearing, across the beam at the centre of rotation. In mm. """

    def to_dict(self) -> dict[str, Any]:
        part = self.part.value

        times_a_turn = self.times_a_turn

        amplitude_deg: float | None | Unset
        if isinstance(self.amplitude_deg, Unset):
            amplitude_deg = UNSET
        else:
            amplitude_deg = self.amplitude_deg

        amplitude_mm: float | None | Unset
        if isinstance(self.amplitude_mm, Unset):
            amplitude_mm = UNSET
        else:
            amplitude_mm = self.amplitude_mm

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "part": part,
                "times_a_turn": times_a_turn,
            }
        )
        if amplitude_deg is not UNSET:
            field_dict["amplitude_deg"] = amplitude_deg
        if amplitude_mm is not UNSET:
            field_dict["amplitude_mm"] = amplitude_mm

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        part = DisturbedPart(d.pop("part"))

        times_a_turn = d.pop("times_a_turn")

        def _parse_amplitude_deg(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        amplitude_deg = _parse_amplitude_deg(d.pop("amplitude_deg", UNSET))

        def _parse_amplitude_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        amplitude_mm = _parse_amplitude_mm(d.pop("amplitude_mm", UNSET))

        turn_disturbance = cls(
            part=part,
            times_a_turn=times_a_turn,
            amplitude_deg=amplitude_deg,
            amplitude_mm=amplitude_mm,
        )

        return turn_disturbance
