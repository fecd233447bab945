"""Metrics of the webhooks: outcomes of attempts, and waiting events."""

from collections.abc import Iterable, Iterator
from datetime import datetime

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from sawmill_platform.contracts.webhooks import Webhook, WebhookState

_GAUGES = {
    "waiting": "Events that wait to be sent, 10 000 at most.",
    "oldest_waiting_seconds": "Age of the oldest event that waits; 0: none does.",
    "paused": "Whether the service gave up on the webhook.",
}


def webhook_measures(webhooks: Iterable[Webhook], now: datetime) -> Iterator[Metric]:
    """Yield a metric family for each measure, with a value for each webhook."""
    sent = CounterMetricFamily(
        "sawmill_webhook_deliveries",
        "Attempts to deliver an event, by outcome: delivered, failed.",
        labels=["webhook", "outcome"],
    )
    gauges = [GaugeMetricFamily(f"sawmill_webhook_{name}", text, labels=["webhook"]) for name, text in _GAUGES.items()]
    for webhook in webhooks:
        sent.add_metric([webhook.id, "delivered"], webhook.delivered)
        sent.add_metric([webhook.id, "failed"], webhook.failed)
        since = webhook.waiting_since
        age_s = 0.0 if since is None else max(0.0, (now - since).total_seconds())
        values = (webhook.waiting, age_s, int(webhook.state is WebhookState.PAUSED))
        for family, value in zip(gauges, values, strict=True):
            family.add_metric([webhook.id], value)
    yield sent
    yield from gauges
