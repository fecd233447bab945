"""A message that somebody sends for a test, now and once, whatever the webhook's state."""

import asyncio
from uuid import uuid4

from sawmill_platform.contracts.webhooks import TestedWebhook, WebhookTest, WebhookTestMessage
from sawmill_service.webhooks.destinations import AllowedDestinations
from sawmill_service.webhooks.messages import headers_of
from sawmill_store.store import Store


def send_test(store: Store, allowed: AllowedDestinations, webhook_id: str) -> WebhookTest:
    """Send it; a thread is held until the receiver has answered, or time is up. Who sends it notes it as well.

    Raises
    ------
    NotFound
        There is no such webhook.
    """
    # Imported here: where nothing may be sent, nobody needs the client.
    from sawmill_service.webhooks.sending import Sending  # noqa: PLC0415

    webhook, secrets = store.webhooks.signing(webhook_id)
    now, message_id = store.now(), f"msg_{uuid4().hex}"
    tested = TestedWebhook(webhook_id=webhook_id, description=webhook.description)
    body = WebhookTestMessage(timestamp=now, data=tested).model_dump_json().encode()
    headers = headers_of(message_id, now, body, secrets)
    answer = asyncio.run(Sending(allowed).post(webhook.url, headers, body))
    return WebhookTest(
        delivered=answer.reason is None,
        message_id=message_id,
        webhook_id=webhook_id,
        status=answer.status,
        reason=answer.reason,
    )
