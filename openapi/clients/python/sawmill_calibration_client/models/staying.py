from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.stays_because import StaysBecause

T = TypeVar("T", bound="Staying")


@_attrs_define
class Staying:
    """What the rules reach, and what stays all the same."""

    because: StaysBecause
    """ Why something that is beyond the rules stays. """
    first_ids: list[str]
    """ Ids of the oldest. """
    number: int
    """ Number of them; one may stay for several reasons. """

    def to_dict(self) -> dict[str, Any]:
        because = self.because.value

        first_ids = self.first_ids

        number = self.number

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "because": because,
                "first_ids": first_ids,
                "number": number,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        because = StaysBecause(d.pop("because"))

        first_ids = cast(list[str], d.pop("first_ids"))

        number = d.pop("number")

        staying = cls(
            because=because,
            first_ids=first_ids,
            number=number,
        )

        return staying
