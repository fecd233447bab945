from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="WebhookAsk")


@_attrs_define
class WebhookAsk:
    """A webhook that is to be kept."""

    url: str
    """ Where events are posted to. Its host must be among the destinations that the service's settings allow;
    `http` reaches allowed networks alone. """
    after: int | None | Unset = UNSET
    """ Send what follows the event of this number: an earlier one sends again, a later one passes over. Null: a new
    webhook begins with now, another one goes on where it stands. """
    description: None | str | Unset = UNSET
    """ Who listens there. Null: not given. """
    enabled: bool | Unset = True
    """ False: nothing is sent until it is enabled; what happens meanwhile is sent then. """
    events: list[str] | Unset = UNSET
    """ Which events are sent: their `what`, or a beginning with `*`, as `alarm-*`; `*` alone: all. """

    def to_dict(self) -> dict[str, Any]:
        url = self.url

        after: int | None | Unset
        if isinstance(self.after, Unset):
            after = UNSET
        else:
            after = self.after

        description: None | str | Unset
        if isinstance(self.description, Unset):
            description = UNSET
        else:
            description = self.description

        enabled = self.enabled

        events: list[str] | Unset = UNSET
        if not isinstance(self.events, Unset):
            events = self.events

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "url": url,
            }
        )
        if after is not UNSET:
            field_dict["after"] = after
        if description is not UNSET:
            field_dict["description"] = description
        if enabled is not UNSET:
            field_dict["enabled"] = enabled
        if events is not UNSET:
            field_dict["events"] = events

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        url = d.pop("url")

        def _parse_after(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        after = _parse_after(d.pop("after", UNSET))

        def _parse_description(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        description = _parse_description(d.pop("description", UNSET))

        enabled = d.pop("enabled", UNSET)

        events = cast(list[str], d.pop("events", UNSET))

        webhook_ask = cls(
            url=url,
            after=after,
            description=description,
            enabled=enabled,
            events=events,
        )

        return webhook_ask
