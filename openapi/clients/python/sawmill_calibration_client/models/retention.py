from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

if TYPE_CHECKING:
    from ..models.removed import Removed
    from ..models.retention_rules import RetentionRules


T = TypeVar("T", bound="Retention")


@_attrs_define
class Retention:
    """The rules in force."""

    changed_at: datetime.datetime | None
    """ When they were changed last, RFC 3339, UTC. Null: there were none yet. """
    changed_by: None | str
    """ Who changed them last: the name of the key. Null: there were none yet. """
    days_wait_since: datetime.datetime | None
    """ Since when rules of days wait for a person to put rules into force anew, RFC 3339, UTC: days were counted
    then, and not for 30 days after it. Null: they do not wait. """
    removed: list[Removed]
    """ What has gone by rules since the beginning, by kind. """
    rules: RetentionRules
    """ How long each kind is kept. A field that is null is no rule; without rules everything stays. """

    def to_dict(self) -> dict[str, Any]:
        changed_at: None | str
        if isinstance(self.changed_at, datetime.datetime):
            changed_at = self.changed_at.isoformat()
        else:
            changed_at = self.changed_at

        changed_by: None | str
        changed_by = self.changed_by

        days_wait_since: None | str
        if isinstance(self.days_wait_since, datetime.datetime):
            days_wait_since = self.days_wait_since.isoformat()
        else:
            days_wait_since = self.days_wait_since

        removed = []
        for removed_item_data in self.removed:
            removed_item = removed_item_data.to_dict()
            removed.append(removed_item)

        rules = self.rules.to_dict()

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "changed_at": changed_at,
                "changed_by": changed_by,
                "days_wait_since": days_wait_since,
                "removed": removed,
                "rules": rules,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.removed import Removed  # noqa: PLC0415
        from ..models.retention_rules import RetentionRules  # noqa: PLC0415

        d = dict(src_dict)

        def _parse_changed_at(data: object) -> datetime.datetime | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                changed_at_type_0 = datetime.datetime.fromisoformat(data)

                return changed_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None, data)

        changed_at = _parse_changed_at(d.pop("changed_at"))

        def _parse_changed_by(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        changed_by = _parse_changed_by(d.pop("changed_by"))

        def _parse_days_wait_since(data: object) -> datetime.datetime | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                days_wait_since_type_0 = datetime.datetime.fromisoformat(data)

                return days_wait_since_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None, data)

        days_wait_since = _parse_days_wait_since(d.pop("days_wait_since"))

        removed = []
        _removed = d.pop("removed")
        for removed_item_data in _removed:
            removed_item = Removed.from_dict(removed_item_data)

            removed.append(removed_item)

        rules = RetentionRules.from_dict(d.pop("rules"))

        retention = cls(
            changed_at=changed_at,
            changed_by=changed_by,
            days_wait_since=days_wait_since,
            removed=removed,
            rules=rules,
        )

        return retention
