from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

from ..models.retention_kind import RetentionKind

T = TypeVar("T", bound="Removed")


@_attrs_define
class Removed:
    """What went of one kind."""

    freed_bytes: int
    """ Bytes that this freed on the disk. Of files with several names, those of the last name alone. """
    kind: RetentionKind
    """ What has rules of its own. """
    number: int
    """ Number of them that went. """

    def to_dict(self) -> dict[str, Any]:
        freed_bytes = self.freed_bytes

        kind = self.kind.value

        number = self.number

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "freed_bytes": freed_bytes,
                "kind": kind,
                "number": number,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        freed_bytes = d.pop("freed_bytes")

        kind = RetentionKind(d.pop("kind"))

        number = d.pop("number")

        removed = cls(
            freed_bytes=freed_bytes,
            kind=kind,
            number=number,
        )

        return removed
