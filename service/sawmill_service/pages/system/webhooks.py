"""`/system/webhooks`: destinations of events, how deliveries go, a test, and pausing; for administrators."""

from fastapi.responses import HTMLResponse, RedirectResponse

from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.contracts.webhooks import WebhookState, WebhookTest
from sawmill_platform.webhooks.webhook_store import WebhookStore
from sawmill_service.dependencies import TheSettings, TheStore
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.languages import marked
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_service.settings import ServiceSettings
from sawmill_service.webhooks.couriers import send_test
from sawmill_service.webhooks.destinations import AllowedDestinations

WEBHOOKS = "/system/webhooks"
STATES = {
    WebhookState.ACTIVE: ("good", marked("Sends")),
    WebhookState.RETRYING: ("watch", marked("Tries again")),
    WebhookState.PAUSED: ("bad", marked("Given up")),
    WebhookState.DISABLED: ("idle", marked("Paused")),
}

router = Router(prefix=WEBHOOKS, include_in_schema=False, reading=Scope.ADMIN)


@router.get("")
def webhooks(page: ThePage, store: TheStore, settings: TheSettings) -> HTMLResponse:
    """Show all webhooks."""
    return _answer(page, store.webhooks, settings)


@router.post("/{webhook_id}/test", needs=Scope.ADMIN)
def try_webhook(webhook_id: Identifier, page: ThePage, store: TheStore, settings: TheSettings) -> HTMLResponse:
    """Send a test, and show the result."""
    tested = send_test(store.webhooks, AllowedDestinations(settings.webhook_destinations), webhook_id)
    return _answer(page, store.webhooks, settings, store.webhooks.note_test(tested))


@router.post("/{webhook_id}/pause", needs=Scope.ADMIN)
def pause_webhook(webhook_id: Identifier, store: TheStore) -> RedirectResponse:
    """Send nothing to a webhook until it is enabled."""
    store.webhooks.enable(webhook_id, enabled=False)
    return RedirectResponse(WEBHOOKS, status_code=303)


@router.post("/{webhook_id}/enable", needs=Scope.ADMIN)
def enable_webhook(webhook_id: Identifier, store: TheStore) -> RedirectResponse:
    """Enable a webhook: send what waits, and continue."""
    store.webhooks.enable(webhook_id, enabled=True)
    return RedirectResponse(WEBHOOKS, status_code=303)


def _answer(
    page: PageFrame, webhooks: WebhookStore, settings: ServiceSettings, tested: WebhookTest | None = None
) -> HTMLResponse:
    return page.answer(
        "webhooks.html", webhooks=webhooks.all(), states=STATES, allowed=settings.webhook_destinations, tested=tested
    )
