from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from attrs import define as _attrs_define

if TYPE_CHECKING:
    from ..models.kind_preview import KindPreview
    from ..models.retention_rules import RetentionRules


T = TypeVar("T", bound="RetentionPreview")


@_attrs_define
class RetentionPreview:
    """What would go by rules at one time. Nothing has gone."""

    at: datetime.datetime
    """ The time for which it is true, RFC 3339, UTC. """
    confirmed: str
    """ Send it with these rules to put them into force; it is good for an hour. """
    kinds: list[KindPreview]
    """ By kind. """
    rules: RetentionRules
    """ How long each kind is kept. A field that is null is no rule; without rules everything stays. """

    def to_dict(self) -> dict[str, Any]:
        at = self.at.isoformat()

        confirmed = self.confirmed

        kinds = []
        for kinds_item_data in self.kinds:
            kinds_item = kinds_item_data.to_dict()
            kinds.append(kinds_item)

        rules = self.rules.to_dict()

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "at": at,
                "confirmed": confirmed,
                "kinds": kinds,
                "rules": rules,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.kind_preview import KindPreview  # noqa: PLC0415
        from ..models.retention_rules import RetentionRules  # noqa: PLC0415

        d = dict(src_dict)
        at = datetime.datetime.fromisoformat(d.pop("at"))

        confirmed = d.pop("confirmed")

        kinds = []
        _kinds = d.pop("kinds")
        for kinds_item_data in _kinds:
            kinds_item = KindPreview.from_dict(kinds_item_data)

            kinds.append(kinds_item)

        rules = RetentionRules.from_dict(d.pop("rules"))

        retention_preview = cls(
            at=at,
            confirmed=confirmed,
            kinds=kinds,
            rules=rules,
        )

        return retention_preview
