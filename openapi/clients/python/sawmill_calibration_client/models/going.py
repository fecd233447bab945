from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

T = TypeVar("T", bound="Going")


@_attrs_define
class Going:
    """One thing that would go."""

    by: str
    """ The rule by which it goes: the field's name. """
    bytes_: int | None
    """ Bytes of its files. Null: it has none. """
    created_at: datetime.datetime
    """ When it came, RFC 3339, UTC. """
    id: str
    """ Its id; of an event, its number. """

    def to_dict(self) -> dict[str, Any]:
        by = self.by

        bytes_: int | None
        bytes_ = self.bytes_

        created_at = self.created_at.isoformat()

        id = self.id

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "by": by,
                "bytes": bytes_,
                "created_at": created_at,
                "id": id,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        by = d.pop("by")

        def _parse_bytes_(data: object) -> int | None:
            if data is None:
                return data
            return cast(int | None, data)

        bytes_ = _parse_bytes_(d.pop("bytes"))

        created_at = datetime.datetime.fromisoformat(d.pop("created_at"))

        id = d.pop("id")

        going = cls(
            by=by,
            bytes_=bytes_,
            created_at=created_at,
            id=id,
        )

        return going
