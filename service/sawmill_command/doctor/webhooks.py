"""Checks of the webhooks: whether events reach their receivers."""

from collections.abc import Iterator

from sawmill_command.doctor.findings import DoctorFinding, State
from sawmill_platform.contracts.webhooks import Webhook, WebhookState
from sawmill_platform.webhooks.webhook_store import WebhookStore
from sawmill_service.webhooks.destinations import SETTING


def webhooks(store: WebhookStore, allowed: list[str]) -> Iterator[DoctorFinding]:
    """Yield a finding for each webhook that does not send, or one finding if all webhooks work."""
    every = store.all().webhooks
    enabled = [webhook for webhook in every if webhook.enabled]
    if enabled and not allowed:
        sentence = f"{len(enabled)} are enabled, and {SETTING} is empty: nothing is sent anywhere"
        yield DoctorFinding("webhooks", State.BAD, sentence, f"set {SETTING}, or disable them (/system/webhooks)")
        return
    failing = [webhook for webhook in every if webhook.state in {WebhookState.RETRYING, WebhookState.PAUSED}]
    for webhook in failing:
        yield _failing(webhook)
    if not failing:
        yield DoctorFinding("webhooks", State.GOOD, f"{len(enabled)} of {len(every)} are enabled, and none fails")


def _failing(webhook: Webhook) -> DoctorFinding:
    name = webhook.description or webhook.url
    sentence = f"{name!r} fails: {webhook.last_failure}; {webhook.waiting} events wait"
    if webhook.state is WebhookState.PAUSED:
        cure = "mend the receiver, send a test, and enable the webhook again (/system/webhooks)"
        return DoctorFinding("webhooks", State.BAD, f"{sentence}, and the service has given up", cure)
    return DoctorFinding("webhooks", State.WATCH, sentence, "mend the receiver: it is tried again by itself")
