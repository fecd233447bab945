"""Messages to webhooks for the OpenAPI document: nobody calls these routes of this service."""

from typing import Annotated

from fastapi import APIRouter, Header

from sawmill_platform.contracts.webhooks import EventMessage, WebhookTestMessage

router = APIRouter(tags=["webhook messages"], generate_unique_id_function=lambda route: route.name)

MessageId = Annotated[
    str,
    Header(
        alias="webhook-id",
        description="Id of the message: the same in every attempt to deliver it.",
        examples=["msg_5d1c8e2c0a7b4f6e9d0c5b8f3f1e2a77"],
    ),
]
SentAt = Annotated[
    int,
    Header(
        alias="webhook-timestamp",
        description="Time of the attempt, seconds since 1970.",
        examples=[1772429464],
    ),
]
Signatures = Annotated[
    str,
    Header(
        alias="webhook-signature",
        description="One or two signatures with a space between: `v1,` and base64 of HMAC-SHA256 of "
        "`webhook-id.webhook-timestamp.body`.",
        examples=["v1,K5oZfzN95Z9UVu1EsfQmfVNQhnkZ2pj9o9NDN/H/pI4="],
    ),
]
RECEIVED = "Any status from 200 to 299: the message was received. The message is sent again after any other status."


@router.post("event", status_code=204, summary="An event", response_description=RECEIVED)
def post_event(message: EventMessage, message_id: MessageId, sent_at: SentAt, signatures: Signatures) -> None:
    """Receive an event: posted to each webhook whose `events` name what happened, in the order of the events."""


@router.post("webhook-test", status_code=204, summary="A test", response_description=RECEIVED)
def post_test(message: WebhookTestMessage, message_id: MessageId, sent_at: SentAt, signatures: Signatures) -> None:
    """Receive a test message: posted by `POST /v1/webhooks/{webhook_id}/test`."""
