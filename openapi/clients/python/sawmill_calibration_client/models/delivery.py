from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.delivery_state import DeliveryState
from ..models.event_kind import EventKind

T = TypeVar("T", bound="Delivery")


@_attrs_define
class Delivery:
    """One event that was sent to a webhook, or was to be."""

    attempts: int
    """ How often it was sent. """
    event_number: int
    """ The event's number in `/v1/events`. """
    first_at: datetime.datetime
    """ The first attempt, RFC 3339, UTC. """
    last_at: datetime.datetime
    """ The last attempt, RFC 3339, UTC. """
    message_id: str
    """ As `webhook-id` has it: the same for every attempt. """
    number: int
    """ Number of the entry; it grows from event to event. """
    reason: None | str
    """ Why the last attempt failed. Null: it did not. """
    state: DeliveryState
    """ Whether an event has reached a webhook. """
    status: int | None
    """ The last answer's status. Null: there was none. """
    what: EventKind
    """ What happened. """

    def to_dict(self) -> dict[str, Any]:
        attempts = self.attempts

        event_number = self.event_number

        first_at = self.first_at.isoformat()

        last_at = self.last_at.isoformat()

        message_id = self.message_id

        number = self.number

        reason: None | str
        reason = self.reason

        state = self.state.value

        status: int | None
        status = self.status

        what = self.what.value

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "attempts": attempts,
                "event_number": event_number,
                "first_at": first_at,
                "last_at": last_at,
                "message_id": message_id,
                "number": number,
                "reason": reason,
                "state": state,
                "status": status,
                "what": what,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        attempts = d.pop("attempts")

        event_number = d.pop("event_number")

        first_at = datetime.datetime.fromisoformat(d.pop("first_at"))

        last_at = datetime.datetime.fromisoformat(d.pop("last_at"))

        message_id = d.pop("message_id")

        number = d.pop("number")

        def _parse_reason(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        reason = _parse_reason(d.pop("reason"))

        state = DeliveryState(d.pop("state"))

        def _parse_status(data: object) -> int | None:
            if data is None:
                return data
            return cast(int | None, data)

        status = _parse_status(d.pop("status"))

        what = EventKind(d.pop("what"))

        delivery = cls(
            attempts=attempts,
            event_number=event_number,
            first_at=first_at,
            last_at=last_at,
            message_id=message_id,
            number=number,
            reason=reason,
            state=state,
            status=status,
            what=what,
        )

        return delivery
