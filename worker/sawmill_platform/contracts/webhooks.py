"""Webhooks: URLs to which events are sent, and the deliveries (https://www.standardwebhooks.com)."""

import re
from collections.abc import Iterable
from enum import StrEnum
from fnmatch import fnmatchcase
from typing import Annotated, Literal, NamedTuple

from pydantic import AfterValidator, Field

from sawmill_platform.contracts import patterns
from sawmill_platform.contracts.base import Contract, Identifier, Name, Stamped, Time
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.events import Event
from sawmill_platform.contracts.given import Given

_URL = re.compile(patterns.WEBHOOK_URL)
_PORTS = {"http": 80, "https": 443}


class Destination(NamedTuple):
    """The parts of a webhook's URL."""

    scheme: str  # `http` or `https`
    host: str  # a name in lower case, or an address, without brackets
    port: int  # port; the scheme's default where the URL has none
    target: str  # path and query

    @property
    def authority(self) -> str:
        """Value of the header `Host`."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return host if self.port == _PORTS[self.scheme] else f"{host}:{self.port}"


def destination_of(url: str) -> Destination:
    """Split a URL into its parts.

    Raises
    ------
    ValueError
        A webhook may not have this URL.
    """
    match = _URL.fullmatch(url)
    if match is None:
        raise ValueError(
            f"must be as in https://alarms.site.example/events, without a user and a fragment, not {url!r}"
        )
    host = match["host"].lower().strip("[]").rstrip(".")
    target = match["target"] or "/"
    path = target if target.startswith("/") else f"/{target}"  # a query may follow the host at once
    return Destination(match["scheme"], host, int(match["port"] or _PORTS[match["scheme"]]), path)


def kinds_of(names: Iterable[str]) -> frozenset[EventType]:
    """Return the kinds of events with one of these names, or with one's beginning before the `*`."""
    return frozenset(kind for name in names for kind in EventType.published() if fnmatchcase(kind, name))


def _check_events(names: list[str]) -> list[str]:
    for name in names:
        if not kinds_of([name]):
            raise ValueError(
                f"must be names of events as /v1/events has them, or beginnings as alarm-* or *, not {name!r}"
            )
    return names


Url = Annotated[
    str,
    AfterValidator(lambda url: destination_of(url) and url),
    Field(
        max_length=2000,
        description="URL to which events are posted. Its host must be among the destinations that the service's "
        "settings allow; `http` reaches allowed networks alone.",
        examples=["https://alarms.site.example/events"],
        json_schema_extra={"pattern": patterns.WEBHOOK_URL_SCHEMA},
    ),
]
EventName = Annotated[str, Field(pattern=patterns.EVENT_NAME, max_length=40)]
EventNames = Annotated[
    list[EventName],
    AfterValidator(_check_events),
    Field(
        min_length=1,
        max_length=50,
        description="Events to send: their `what`, or a beginning with `*`, as `alarm-*`; `*` alone: all.",
        examples=[["alarm-*", "failed"]],
    ),
]


class WebhookRequest(Given):
    """A webhook to be stored."""

    url: Url
    description: Name | None = Field(
        None, description="Receiver of the messages. Null: not given.", examples=["shift office"]
    )
    events: EventNames = Field(["alarm-*"])
    enabled: bool = Field(
        default=True,
        description="Whether events are sent; false: none until it is enabled, when all events since are sent.",
    )
    after: int | None = Field(
        None,
        ge=0,
        le=2**31 - 1,
        description="Number of an event: the events after it are sent. An earlier number sends events again, a "
        "later one skips events. Null: a new webhook begins now, another one continues at its present event.",
        examples=[None],
    )


class WebhookState(StrEnum):
    """State of a webhook."""

    ACTIVE = "active"
    RETRYING = "retrying"
    PAUSED = "paused"
    DISABLED = "disabled"


class Webhook(Stamped):
    """A webhook in its present state, without its secret."""

    url: Url
    description: Name | None = Field(
        description="Receiver of the messages. Null: not given.", examples=["shift office"]
    )
    events: EventNames
    enabled: bool = Field(description="Whether anything is sent.", examples=[True])
    state: WebhookState = Field(
        description="`retrying`: the last attempt failed, and `next_attempt_at` is the next; `paused`: the service "
        "gave up, for `last_failure`, and continues once `enabled` is set again; `disabled`: somebody turned the "
        "webhook off.",
        examples=["active"],
    )
    after: int = Field(description="Number of the last event that has been processed.", examples=[42])
    waiting: int = Field(description="Number of events to be sent; 10000: that number or more.", examples=[0])
    waiting_since: Time | None = Field(
        description="Time of the oldest event to be sent, RFC 3339, UTC. Null: none waits."
    )
    delivered: int = Field(description="Number of events that were delivered.", examples=[120])
    failed: int = Field(description="Number of attempts that failed.", examples=[3])
    failures: int = Field(description="Number of attempts that failed since the last delivered event.", examples=[0])
    next_attempt_at: Time | None = Field(
        description="Time of the next attempt, RFC 3339, UTC. Null: no attempt has failed.", examples=[None]
    )
    last_success_at: Time | None = Field(description="Time of the last delivery, RFC 3339, UTC. Null: never.")
    last_failure_at: Time | None = Field(
        description="Time of the last failed attempt, RFC 3339, UTC. Null: never.", examples=[None]
    )
    last_failure: str | None = Field(
        description="Reason of the last failed attempt. Null: none has failed.", examples=["it answered 500"]
    )
    previous_secret_until: Time | None = Field(
        description="Time until which each message is also signed with the previous secret, RFC 3339, UTC. Null: "
        "the secret has never been replaced.",
        examples=[None],
    )


class NewWebhook(Webhook):
    """A webhook with its secret, which is shown here and never again."""

    secret: str = Field(
        repr=False,
        description="Key of the messages' signatures: `whsec_` and base64 of 32 random bytes.",
        examples=["whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"],
    )


class WebhookRotation(Given):
    """Replacement of a webhook's secret."""

    grace_s: int = Field(
        86400,
        ge=0,
        le=30 * 86400,
        description="Seconds for which messages are signed with the old secret too, so that the receiver can be "
        "given the new one.",
    )


class DeliveryState(StrEnum):
    """State of a delivery: whether the event has reached the webhook."""

    DELIVERED = "delivered"
    RETRYING = "retrying"
    FAILED = "failed"


class Delivery(Contract):
    """An event that was sent to a webhook, or is to be sent."""

    number: int = Field(description="Number of the entry; it grows from event to event.", examples=[41])
    message_id: str = Field(
        description="Header `webhook-id` of the message: the same for every attempt.",
        examples=["msg_0f8b4c6d0d8a4b0e9d0c5b8f3f1e2a77"],
    )
    event_number: int = Field(description="The event's number in `/v1/events`.", examples=[42])
    type: EventType = Field(description="Kind of the event.", examples=["alarm-opened"])
    state: DeliveryState = Field(
        description="`failed`: the service gave up and paused the webhook; enabled again, it begins with this event.",
        examples=["delivered"],
    )
    attempts: int = Field(description="Number of attempts.", examples=[1])
    first_at: Time = Field(description="Time of the first attempt, RFC 3339, UTC.")
    last_at: Time = Field(description="Time of the last attempt, RFC 3339, UTC.")
    status: int | None = Field(description="HTTP status of the last answer. Null: there was no answer.", examples=[200])
    reason: str | None = Field(
        description="Reason why the last attempt failed. Null: it did not fail.", examples=[None]
    )


class WebhookTest(Contract):
    """Outcome of a test message."""

    delivered: bool = Field(description="Whether the receiver answered with 200 to 299.", examples=[True])
    message_id: str = Field(
        description="Header `webhook-id` of the message.", examples=["msg_0f8b4c6d0d8a4b0e9d0c5b8f3f1e2a77"]
    )
    webhook_id: Identifier = Field(description="Id of the webhook.")
    status: int | None = Field(description="HTTP status of the answer. Null: there was no answer.", examples=[200])
    reason: str | None = Field(
        description="Reason why the message was not delivered. Null: it was delivered.", examples=[None]
    )


class EventMessage(Contract):
    """A message that is posted to a webhook when something has happened."""

    type: EventType = Field(description="Kind of the event, as in `data`.", examples=["alarm-opened"])
    timestamp: Time = Field(description="Time of the event, RFC 3339, UTC.")
    data: Event = Field(description="The event as in `/v1/events`.")


class TestedWebhook(Contract):
    """The webhook to which a test message is sent."""

    webhook_id: Identifier
    description: Name | None = Field(
        description="Receiver of the messages. Null: not given.", examples=["shift office"]
    )


class WebhookTestMessage(Contract):
    """A test message to a webhook."""

    type: Literal["webhook-test"] = Field("webhook-test", description="Type of a test message.")
    timestamp: Time = Field(description="Time at which the message was sent, RFC 3339, UTC.")
    data: TestedWebhook = Field(description="The webhook to which the message was sent.")
