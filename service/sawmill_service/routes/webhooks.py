"""/v1/webhooks, and for the OpenAPI document the messages to webhooks, which nobody posts to this service."""

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Header, Query, Response
from fastapi.concurrency import run_in_threadpool

from sawmill_platform.contracts.base import Identifier, Page
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.contracts.webhooks import (
    Delivery,
    EventMessage,
    NewWebhook,
    Webhook,
    WebhookRequest,
    WebhookRotation,
    WebhookTest,
    WebhookTestMessage,
    destination_of,
)
from sawmill_service.dependencies import TheSettings, TheStore
from sawmill_service.http.bodies.sent_json import Sent
from sawmill_service.http.document.described_answers import LOCATED, refuses
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.problems import Refused
from sawmill_service.http.repeats import TheRepeatable, repeatable
from sawmill_service.http.responses.answers import NumberedPaging, Paging
from sawmill_service.http.responses.conditional import REPLACED, TAGGED, ThePrecondition, tagged
from sawmill_service.http.route_rules import Router
from sawmill_service.settings import ServiceSettings
from sawmill_service.webhooks.couriers import send_test
from sawmill_service.webhooks.destinations import AllowedDestinations, RefusedDestinationError

messages = APIRouter(tags=["webhook messages"], generate_unique_id_function=lambda route: route.name)

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
    Header(alias="webhook-timestamp", description="Time of the attempt, seconds since 1970.", examples=[1772429464]),
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


@messages.post("event", status_code=204, summary="An event", response_description=RECEIVED)
def post_event(message: EventMessage, message_id: MessageId, sent_at: SentAt, signatures: Signatures) -> None:
    """Receive an event: posted to each webhook whose `events` name what happened, in the order of the events."""


@messages.post("webhook-test", status_code=204, summary="A test", response_description=RECEIVED)
def post_test(message: WebhookTestMessage, message_id: MessageId, sent_at: SentAt, signatures: Signatures) -> None:
    """Receive a test message: posted by `POST /v1/webhooks/{webhook_id}/test`."""


router = Router(prefix="/v1/webhooks", tags=["webhooks"], reading=Scope.ADMIN)

EXAMPLE = {
    "url": "https://alarms.mill.example/sawmill",
    "description": "shift office",
    "events": ["alarm-*", "failed"],
    "enabled": False,
}
FOR_A_DAY = WebhookRotation()


@router.post(
    "",
    needs=Scope.ADMIN,
    status_code=201,
    summary="Add a webhook",
    openapi_extra=trying(body=EXAMPLE),
    responses=LOCATED | refuses("destination-not-allowed", "too-many-webhooks", "secret-not-repeated"),
)
@repeatable
def create_webhook(ask: Sent[WebhookRequest], store: TheStore, settings: TheSettings, response: Response) -> NewWebhook:
    """Add a webhook for events, signed as in Standard Webhooks. Its secret is in this answer and nowhere else.

    The destination must be one that `SAWMILL_WEBHOOK_DESTINATIONS` allows, which is empty at first.
    """
    _check(ask, settings)
    webhook = store.webhooks.create(ask)
    response.headers["Location"] = f"/v1/webhooks/{webhook.id}"
    response.headers["Cache-Control"] = "no-store"
    return webhook


@router.get("", summary="List webhooks, newest first", responses=refuses("invalid-cursor"))
def list_webhooks(paging: Annotated[Paging, Query()], store: TheStore) -> Page[Webhook]:
    """List webhooks without their secrets, each with its waiting events, and its last success and failure."""
    return store.webhooks.page(after=paging.after, limit=paging.limit)


@router.get("/{webhook_id}", summary="Get a webhook", responses=TAGGED | refuses("webhook-not-found"))
def get_webhook(webhook_id: Identifier, store: TheStore, response: Response) -> Webhook:
    """Return the webhook's state and its waiting events."""
    return tagged(response, store.webhooks.get(webhook_id))


@router.put(
    "/{webhook_id}",
    needs=Scope.ADMIN,
    summary="Replace a webhook",
    openapi_extra=trying(body=EXAMPLE),
    responses=REPLACED | refuses("webhook-not-found", "destination-not-allowed"),
)
def replace_webhook(
    webhook_id: Identifier,
    ask: Sent[WebhookRequest],
    store: TheStore,
    settings: TheSettings,
    precondition: ThePrecondition,
    response: Response,
) -> Webhook:
    """Replace a webhook; its secret stays. If it is enabled, waiting events are sent at once, also if it was paused."""
    _check(ask, settings)
    return tagged(response, store.webhooks.update(webhook_id, ask, check=precondition))


@router.delete(
    "/{webhook_id}",
    needs=Scope.ADMIN,
    status_code=204,
    summary="Delete a webhook",
    openapi_extra=trying(webhook_id="example-spare"),
    responses=refuses("webhook-not-found"),
)
def delete_webhook(webhook_id: Identifier, store: TheStore) -> None:
    """Delete a webhook and its list of deliveries; nothing more is sent to it."""
    store.webhooks.delete(webhook_id)


@router.post(
    "/{webhook_id}/test", needs=Scope.ADMIN, summary="Send a test to a webhook", responses=refuses("webhook-not-found")
)
async def test_webhook(
    webhook_id: Identifier, store: TheStore, settings: TheSettings, repeatable: TheRepeatable
) -> WebhookTest:
    """Send one message of the type `webhook-test` now, also to a disabled webhook; the answer has the outcome."""
    await repeatable.check_sent()
    # Sent before the transaction, so that no lock waits for a receiver.
    tested = await run_in_threadpool(
        send_test, store.webhooks, AllowedDestinations(settings.webhook_destinations), webhook_id
    )
    return await run_in_threadpool(repeatable.once, partial(store.webhooks.note_test, tested))


@router.post(
    "/{webhook_id}/rotate",
    needs=Scope.ADMIN,
    summary="Replace a webhook's secret",
    openapi_extra=trying(body={"grace_s": 3600}),
    responses=refuses("webhook-not-found", "secret-not-repeated"),
)
@repeatable
def rotate_webhook(
    webhook_id: Identifier, store: TheStore, response: Response, rotation: Sent[WebhookRotation] = FOR_A_DAY
) -> NewWebhook:
    """Replace the secret; for the grace period both sign messages. The new one is in this answer and nowhere else."""
    response.headers["Cache-Control"] = "no-store"
    return store.webhooks.rotate(webhook_id, grace_s=rotation.grace_s)


@router.get(
    "/{webhook_id}/deliveries",
    summary="List a webhook's deliveries",
    responses=refuses("webhook-not-found", "invalid-cursor"),
)
def list_deliveries(
    webhook_id: Identifier, paging: Annotated[NumberedPaging, Query()], store: TheStore
) -> Page[Delivery]:
    """List one entry for each event, the newest first; each is kept for a week after its last attempt."""
    return store.webhooks.deliveries(webhook_id, after=paging.after, limit=paging.limit)


def _check(ask: WebhookRequest, settings: ServiceSettings) -> None:
    try:
        AllowedDestinations(settings.webhook_destinations).check(destination_of(ask.url))
    except RefusedDestinationError as refused:
        raise Refused(422, "destination-not-allowed", str(refused)) from refused
