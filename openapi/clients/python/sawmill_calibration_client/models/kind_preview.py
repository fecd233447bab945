from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.retention_kind import RetentionKind

if TYPE_CHECKING:
    from ..models.going import Going
    from ..models.staying import Staying


T = TypeVar("T", bound="KindPreview")


@_attrs_define
class KindPreview:
    """What would go of one kind, and what would stay although the rules reach it."""

    bytes_: int | None
    """ Bytes of their files; those with several names count with each. Null: it has none, or no rule. """
    first: list[Going]
    """ The first that would go: the oldest. """
    kind: RetentionKind
    """ What has rules of its own. """
    newest_at: datetime.datetime | None
    """ When the newest that would go came, RFC 3339, UTC. Null: none would. """
    number: int
    """ Number of them that would go. """
    oldest_at: datetime.datetime | None
    """ When the oldest that would go came, RFC 3339, UTC. Null: none would. """
    stays: list[Staying]
    """ What stays although the rules reach it, by reason. """

    def to_dict(self) -> dict[str, Any]:
        bytes_: int | None
        bytes_ = self.bytes_

        first = []
        for first_item_data in self.first:
            first_item = first_item_data.to_dict()
            first.append(first_item)

        kind = self.kind.value

        newest_at: None | str
        if isinstance(self.newest_at, datetime.datetime):
            newest_at = self.newest_at.isoformat()
        else:
            newest_at = self.newest_at

        number = self.number

        oldest_at: None | str
        if isinstance(self.oldest_at, datetime.datetime):
            oldest_at = self.oldest_at.isoformat()
        else:
            oldest_at = self.oldest_at

        stays = []
        for stays_item_data in self.stays:
            stays_item = stays_item_data.to_dict()
            stays.append(stays_item)

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "bytes": bytes_,
                "first": first,
                "kind": kind,
                "newest_at": newest_at,
                "number": number,
                "oldest_at": oldest_at,
                "stays": stays,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.going import Going  # noqa: PLC0415
        from ..models.staying import Staying  # noqa: PLC0415

        d = dict(src_dict)

        def _parse_bytes_(data: object) -> int | None:
            if data is None:
                return data
            return cast(int | None, data)

        bytes_ = _parse_bytes_(d.pop("bytes"))

        first = []
        _first = d.pop("first")
        for first_item_data in _first:
            first_item = Going.from_dict(first_item_data)

            first.append(first_item)

        kind = RetentionKind(d.pop("kind"))

        def _parse_newest_at(data: object) -> datetime.datetime | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                newest_at_type_0 = datetime.datetime.fromisoformat(data)

                return newest_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None, data)

        newest_at = _parse_newest_at(d.pop("newest_at"))

        number = d.pop("number")

        def _parse_oldest_at(data: object) -> datetime.datetime | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                oldest_at_type_0 = datetime.datetime.fromisoformat(data)

                return oldest_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None, data)

        oldest_at = _parse_oldest_at(d.pop("oldest_at"))

        stays = []
        _stays = d.pop("stays")
        for stays_item_data in _stays:
            stays_item = Staying.from_dict(stays_item_data)

            stays.append(stays_item)

        kind_preview = cls(
            bytes_=bytes_,
            first=first,
            kind=kind,
            newest_at=newest_at,
            number=number,
            oldest_at=oldest_at,
            stays=stays,
        )

        return kind_preview
