from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.webhook_state import WebhookState

T = TypeVar("T", bound="Webhook")


@_attrs_define
class Webhook:
    """A webhook as it stands, without its secret."""

    after: int
    """ Number of the last event with which it is done. """
    created_at: datetime.datetime
    """ When it was created, RFC 3339, UTC. """
    delivered: int
    """ Events that were delivered. """
    description: None | str
    """ Who listens there. Null: not given. """
    enabled: bool
    """ Whether anything is sent. """
    events: list[str]
    """ Which events are sent: their `what`, or a beginning with `*`, as `alarm-*`; `*` alone: all. """
    failed: int
    """ Attempts that failed. """
    failures: int
    """ Of these, how many since the last event that was delivered. """
    id: str
    """ The resource's id, which the service gives. """
    last_failure: None | str
    """ Why the last attempt that failed did so. Null: none has. """
    last_failure_at: datetime.datetime | None
    """ When an attempt last failed, RFC 3339, UTC. Null: never. """
    last_success_at: datetime.datetime | None
    """ When an event was last delivered, RFC 3339, UTC. Null: never. """
    next_attempt_at: datetime.datetime | None
    """ When it is tried again, RFC 3339, UTC. Null: no attempt has failed. """
    previous_secret_until: datetime.datetime | None
    """ Until then each message is signed with the secret before as well, RFC 3339, UTC. Null: it has never been
    replaced. """
    state: WebhookState
    """ How a webhook stands. """
    url: str
    """ Where events are posted to. Its host must be among the destinations that the service's settings allow;
    `http` reaches allowed networks alone. """
    waiting: int
    """ Events that are to be sent to it; 10000: that number or more. """
    waiting_since: datetime.datetime | None
    """ When the oldest of these happened, RFC 3339, UTC. Null: none waits. """

    def to_dict(self) -> dict[str, Any]:
        after = self.after

        created_at = self.created_at.isoformat()

        delivered = self.delivered

        description: None | str
        description = self.description

        enabled = self.enabled

        events = self.events

        failed = self.failed

        failures = self.failures

        id = self.id

        last_failure: None | str
        last_failure = self.last_failure

        last_failure_at: None | str
        if isinstance(self.last_failure_at, datetime.datetime):
            last_failure_at = self.last_failure_at.isoformat()
        else:
            last_failure_at = self.last_failure_at

        last_success_at: None | str
        if isinstance(self.last_success_at, datetime.datetime):
            last_success_at = self.last_success_at.isoformat()
        else:
            last_success_at = self.last_success_at

        next_attempt_at: None | str
        if isinstance(self.next_attempt_at, datetime.datetime):
            next_attempt_at = self.next_attempt_at.isoformat()
        else:
            next_attempt_at = self.next_attempt_at

        previous_secret_until: None | str
        if isinstance(self.previous_secret_until, datetime.datetime):
            previous_secret_until = self.previous_secret_until.isoformat()
        else:
            previous_secret_until = self.previous_secret_until

        state = self.state.value

        url = self.url

        waiting = self.waiting

        waiting_since: None | str
        if isinstance(self.waiting_since, datetime.datetime):
            waiting_since = self.waiting_since.isoformat()
        else:
            waiting_since = self.waiting_since

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "after": after,
                "created_at": created_at,
                "delivered": delivered,
                "description": description,
                "enabled": enabled,
                "events": events,
                "failed": failed,
                "failures": failures,
                "id": id,
                "last_failure": last_failure,
                "last_failure_at": last_failure_at,
                "last_success_at": last_success_at,
                "next_attempt_at": next_attempt_at,
                "previous_secret_until": previous_secret_until,
                "state": state,
                "url": url,
                "waiting": waiting,
                "waiting_since": waiting_since,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        after = d.pop("after")

        created_at = datetime.datetime.fromisoformat(d.pop("created_at"))

        delivered = d.pop("delivered")

        def _parse_description(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        description = _parse_description(d.pop("description"))

        enabled = d.pop("enabled")

        events = cast(list[str], d.pop("events"))

        failed = d.pop("failed")

        failures = d.pop("failures")

        id = d.pop("id")

        def _parse_last_failure(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        last_failure = _parse_last_failure(d.pop("last_failure"))

        def _parse_last_failure_at(data: object) -> datetime.datetime | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                last_failure_at_type_0 = datetime.datetime.fromisoformat(data)

                return last_failure_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None, data)

        last_failure_at = _parse_last_failure_at(d.pop("last_failure_at"))

        def _parse_last_success_at(data: object) -> datetime.datetime | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                last_success_at_type_0 = datetime.datetime.fromisoformat(data)

                return last_success_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None, data)

        last_success_at = _parse_last_success_at(d.pop("last_success_at"))

        def _parse_next_attempt_at(data: object) -> datetime.datetime | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                next_attempt_at_type_0 = datetime.datetime.fromisoformat(data)

                return next_attempt_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None, data)

        next_attempt_at = _parse_next_attempt_at(d.pop("next_attempt_at"))

        def _parse_previous_secret_until(data: object) -> datetime.datetime | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                previous_secret_until_type_0 = datetime.datetime.fromisoformat(data)

                return previous_secret_until_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None, data)

        previous_secret_until = _parse_previous_secret_until(d.pop("previous_secret_until"))

        state = WebhookState(d.pop("state"))

        url = d.pop("url")

        waiting = d.pop("waiting")

        def _parse_waiting_since(data: object) -> datetime.datetime | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                waiting_since_type_0 = datetime.datetime.fromisoformat(data)

                return waiting_since_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None, data)

        waiting_since = _parse_waiting_since(d.pop("waiting_since"))

        webhook = cls(
            after=after,
            created_at=created_at,
            delivered=delivered,
            description=description,
            enabled=enabled,
            events=events,
            failed=failed,
            failures=failures,
            id=id,
            last_failure=last_failure,
            last_failure_at=last_failure_at,
            last_success_at=last_success_at,
            next_attempt_at=next_attempt_at,
            previous_secret_until=previous_secret_until,
            state=state,
            url=url,
            waiting=waiting,
            waiting_since=waiting_since,
        )

        return webhook
