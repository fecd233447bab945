"""Test message to a webhook: sent at once and once, whatever the webhook's state."""

import asyncio
from uuid import uuid4

from sawmill_platform.contracts.webhooks import TestedWebhook, WebhookTest, WebhookTestMessage
from sawmill_platform.webhooks.webhook_store import WebhookStore
from sawmill_service.webhooks.destinations import AllowedDestinations
from sawmill_service.webhooks.messages import headers_of


def send_test(webhooks: WebhookStore, allowed: AllowedDestinations, webhook_id: str) -> WebhookTest:
    """Send a test message, and wait in this thread for the answer or the time limit; the caller notes the result."""
    # Imported here: the HTTP client is not needed where nothing may be sent.
    from sawmill_service.webhooks.sending import WebhookSending  # noqa: PLC0415

    webhook, secrets, now = webhooks.signing(webhook_id)
    message_id = f"msg_{uuid4().hex}"
    tested = TestedWebhook(webhook_id=webhook_id, description=webhook.description)
    body = WebhookTestMessage(timestamp=now, data=tested).model_dump_json().encode()
    headers = headers_of(message_id, now, body, secrets)
    answer = asyncio.run(WebhookSending(allowed).post(webhook.url, headers, body))
    return WebhookTest(
        delivered=answer.reason is None,
        message_id=message_id,
        webhook_id=webhook_id,
        status=answer.status,
        reason=answer.reason,
    )
