"""Webhooks over HTTP and on their page, where they may lead, and what the doctor, the metrics and the log say."""

import ipaddress
import json
from contextlib import suppress

import pytest
from asgi import absent, refusal, text_of
from pydantic import ValidationError
from receivers import receiving, status

from sawmill_command.doctor.store import webhooks as findings
from sawmill_contracts import mill_events
from sawmill_platform.contracts.events import Event
from sawmill_platform.contracts.webhooks import WebhookRequest, destination_of
from sawmill_platform.ledger.events import announce
from sawmill_platform.webhooks.outbox import DeliveryAttempt
from sawmill_service.app import create_app
from sawmill_service.settings import ServiceSettings
from sawmill_service.webhooks.destinations import AllowedDestinations, RefusedDestinationError

URL = "https://alarms.mill.example/sawmill"


def happen(store) -> Event:
    with store.database.write() as session:
        announce(session, store.database.now(), mill_events.ALARM_OPENED, "scanner", "line-2")
    return store.events.following(0)[-1]


def fail(store, webhook_id: str, wait_s: float | None) -> None:
    outbox = store.outbox()
    pending = outbox.pending(webhook_id, 10**6)
    outbox.note(pending, pending.events[0], DeliveryAttempt(500, "it answered 500", wait_s))


def test_a_webhook_lives_from_creation_to_deletion_and_can_be_led_to_no_other_host(client, store):
    made = client.post("/v1/webhooks", json={"url": URL, "events": ["alarm-*", "failed"]})
    assert (made.status_code, made.headers["Cache-Control"]) == (201, "no-store")
    webhook = made.json()
    secret, path = webhook.pop("secret"), made.headers["Location"]
    assert secret.startswith("whsec_")
    assert (client.get(path).json(), client.get("/v1/webhooks").json()) == (webhook, {"items": [webhook], "next": None})
    changed = client.put(path, json={"url": f"{URL}/2", "description": "office", "events": ["*"], "enabled": False})
    assert (changed.json()["state"], changed.json()["description"]) == ("disabled", "office")
    rotated = client.post(f"{path}/rotate", json={"grace_s": 60}).json()
    assert rotated["secret"] != secret
    assert rotated["previous_secret_until"] is not None
    assert (client.delete(path).status_code, client.get(path).json()["code"]) == (204, "webhook-not-found")
    key = {"Idempotency-Key": "1"}
    made = client.post("/v1/webhooks", json={"url": URL}, headers=key).json()
    again = client.post("/v1/webhooks", json={"url": URL}, headers=key)
    assert again.json()["code"] == "secret-not-repeated"
    assert f"webhook '{made['id']}' stood in its answer alone: POST /v1/webhooks/{made['id']}/rotate" in again.text
    webhook = store.webhooks.create(WebhookRequest(url=URL))
    for url in ("https://evil.example/", "https://alarms.mill.example:22/", "https://10.1.2.3/"):
        assert refusal(client.put(f"/v1/webhooks/{webhook.id}", json={"url": url})) == (422, "destination-not-allowed")
    assert store.webhooks.get(webhook.id).url == URL
    refused = client.post("/v1/webhooks", json={"url": URL, "events": ["alarms"]}).json()
    cure = "must be names of events as /v1/events has them, or beginnings as alarm-* or *, not 'alarms'"
    assert cure in refused["detail"]


@pytest.mark.usefixtures("without_network")
def test_at_first_every_webhook_is_refused_with_what_to_set_and_nothing_is_looked_up(client, store):
    client.app = create_app(ServiceSettings(), store, print)
    refused = client.post("/v1/webhooks", json={"url": URL})
    assert refusal(refused) == (422, "destination-not-allowed")
    what_to_set = 'set SAWMILL_WEBHOOK_DESTINATIONS to ["alarms.mill.example"] and start the service again'
    assert (refused.json()["detail"], store.webhooks.all()) == (f"nothing is sent anywhere: {what_to_set}", [])
    assert "Nothing is sent anywhere: no destination is allowed." in text_of(client.get("/system/webhooks").text)
    webhook = store.webhooks.create(WebhookRequest(url=URL))
    assert "nothing is sent anywhere" in client.post(f"/v1/webhooks/{webhook.id}/test").json()["reason"]


def test_a_test_is_sent_at_once_and_says_how_it_went(client, store):
    with receiving() as receiver:
        webhook = store.webhooks.create(WebhookRequest(url=receiver.url, enabled=False))
        receiver.answers = [status(204), status(500)]
        went = client.post(f"/v1/webhooks/{webhook.id}/test").json()
        [message] = receiver.messages
        assert (went["delivered"], went["status"], went["message_id"]) == (True, 204, message.id)
        assert message.is_signed_with(webhook.secret)
        assert json.loads(message.body)["type"] == "webhook-test"
        failed = client.post(f"/v1/webhooks/{webhook.id}/test").json()
        assert (failed["delivered"], failed["reason"]) == (False, "it answered 500")
        key = {"Idempotency-Key": "once"}
        first, again = (client.post(f"/v1/webhooks/{webhook.id}/test", headers=key) for _ in range(2))
        assert (again.json(), again.headers["Idempotency-Replayed"]) == (first.json(), "true")
        assert len(receiver.messages) == 3
    assert store.webhooks.get(webhook.id).state == "disabled"
    assert [event.detail for event in store.events.following(0)[-3:]] == [{}, {"reason": "it answered 500"}, {}]


@pytest.mark.parametrize("language", ["en", "fi"])
def test_the_page_shows_how_each_stands_and_tests_pauses_and_enables(client, store, language):
    client.headers = {"Accept-Language": language}
    with receiving() as receiver:
        webhook = store.webhooks.create(WebhookRequest(url=receiver.url, description="office <1>"))
        here = f"/system/webhooks/{webhook.id}"
        happen(store)
        fail(store, webhook.id, 60.0)
        page = client.get("/system/webhooks").text
        text = text_of(page)
        assert "office &lt;1&gt;" in page
        assert absent(text, {"en": "Tries again", "fi": "Yrittää uudelleen"}[language], "it answered 500") == []
        assert webhook.secret not in page
        tested = text_of(client.post(f"{here}/test").text)
        assert {"en": "The test arrived: it was answered with 204.", "fi": "vastaus oli 204"}[language] in tested
        receiver.usual = status(503)
        tested = text_of(client.post(f"{here}/test").text)
        assert {"en": "The test did not arrive: it answered 503", "fi": "Testi ei mennyt perille:"}[language] in tested
        assert client.post(f"{here}/pause").headers["Location"] == "/system/webhooks"
        assert {"en": "Paused", "fi": "Keskeytetty"}[language] in text_of(client.get("/system/webhooks").text)
        assert (client.post(f"{here}/enable").status_code, store.webhooks.get(webhook.id).state) == (303, "active")


def test_metrics_count_attempts_and_what_waits(client, store):
    webhook = store.webhooks.create(WebhookRequest(url=URL))
    happen(store)
    fail(store, webhook.id, None)
    label, scraped = f'{{webhook="{webhook.id}"}}', client.get("/metrics").text
    assert f'sawmill_webhook_deliveries_total{{outcome="failed",webhook="{webhook.id}"}} 1.0' in scraped
    assert absent(scraped, f"sawmill_webhook_waiting{label} 1.0", f"sawmill_webhook_paused{label} 1.0") == []
    assert f"sawmill_webhook_oldest_waiting_seconds{label} 0." in scraped


def test_the_doctor_names_a_webhook_that_fails_its_reason_and_the_cure(store):
    def found(*allowed: str) -> list[tuple[str, str]]:
        return [(finding.state.value, finding.sentence) for finding in findings(store.webhooks, list(allowed))]

    assert found() == [("good", "0 of 0 are enabled, and none fails")]
    webhook = store.webhooks.create(WebhookRequest(url=URL, description="office"))
    assert found() == [("bad", "1 are enabled, and SAWMILL_WEBHOOK_DESTINATIONS is empty: nothing is sent anywhere")]
    assert found("alarms.mill.example") == [("good", "1 of 1 are enabled, and none fails")]
    happen(store)
    fail(store, webhook.id, 60.0)
    store.webhooks.enable(webhook.id, enabled=True)
    fail(store, webhook.id, 60.0)
    assert found("alarms.mill.example") == [("watch", "'office' fails: it answered 500; 1 events wait")]
    store.webhooks.enable(webhook.id, enabled=True)
    fail(store, webhook.id, None)
    given_up = "'office' fails: it answered 500; 1 events wait, and the service has given up"
    assert found("alarms.mill.example") == [("bad", given_up)]


def undo(store) -> None:
    with suppress(ZeroDivisionError), store.database.write() as session:
        announce(session, store.database.now(), mill_events.ALARM_OPENED, "scanner", "undone")
        session.flush()
        _ = 1 / 0


def test_each_event_is_a_line_of_the_log_once_it_is_committed(store, log_lines):
    event = happen(store)
    [line] = [line for line in log_lines() if line["event"] == "event"]
    assert (line["number"], line["type"], line["subject_id"]) == (event.number, "alarm-opened", "line-2")
    undo(store)
    with store.database.write_as_one():
        undo(store)
        happen(store)
        assert log_lines() == []
    assert [line["subject_id"] for line in log_lines()] == ["line-2"]


# Where webhooks may lead.


def allowed(url: str, *entries: str, addresses: tuple[str, ...] = ()) -> bool:
    destinations, destination = AllowedDestinations(entries), destination_of(url)
    try:
        destinations.check(destination)
        checked = destinations.check_addresses(addresses, destination)
    except RefusedDestinationError:
        return False
    assert [ipaddress.ip_address(each) for each in checked] == [ipaddress.ip_address(each) for each in addresses]
    return True


PUBLIC = ("93.184.216.34", "2606:2800:220:1::1")
NOT_PUBLIC = [
    *("127.0.0.1", "10.1.2.3", "172.16.0.1", "192.168.1.2", "169.254.169.254", "100.64.0.1", "0.0.0.0"),  # noqa: S104
    *("224.0.0.1", "255.255.255.255", "198.18.0.1", "192.0.2.1", "::1", "::", "fe80::1", "fe80::1%eth0", "fd00::1"),
    *("ff02::1", "::ffff:127.0.0.1", "::ffff:169.254.169.254", "64:ff9b::a9fe:a9fe", "2002:7f00:1::1", "2001::1"),
    *("::127.0.0.1", "::ffff:0:7f00:1", "fec0::1", "4000::1", "not an address"),
    *("192.0.0.9", "192.0.0.192", "192.88.99.1", "3fff::1", "3fff:fff::1"),
]


def test_listed_names_ports_and_networks_are_allowed_and_other_names_lead_to_public_addresses_alone():
    for address in NOT_PUBLIC:
        assert not allowed(URL, "alarms.mill.example", addresses=(address,)), address
        assert not allowed(URL, "alarms.mill.example", addresses=(*PUBLIC, address)), address
    assert allowed(URL, "alarms.mill.example", addresses=PUBLIC)
    assert allowed(URL, "Alarms.Mill.Example", addresses=PUBLIC)
    assert allowed(URL, "alarms.mill.example", "10.20.0.0/16", addresses=("10.20.0.1", *PUBLIC))
    assert not allowed(URL, "alarms.mill.example", "10.20.0.0/16", addresses=("10.21.0.1",))
    assert allowed("https://mes.mill.example:8443/", "mes.mill.example:8443", addresses=PUBLIC)
    assert not allowed("https://mes.mill.example/", "mes.mill.example:8443")
    assert not allowed("https://mes.mill.example:8443/", "mes.mill.example")
    assert not allowed("https://sub.alarms.mill.example/", "alarms.mill.example")
    assert not allowed(URL, "10.20.0.0/16")  # a name is looked up only where it is listed
    plain = "http://alarms.mill.example/"
    assert not allowed(plain, "alarms.mill.example")
    assert not allowed(plain, "alarms.mill.example", "10.20.0.0/16", addresses=PUBLIC)
    assert allowed(plain, "alarms.mill.example", "10.20.0.0/16", addresses=("10.20.0.1",))
    assert allowed("http://127.0.0.1:8080/", "127.0.0.1", addresses=("127.0.0.1",))
    assert allowed("https://[fd00::1]/", "fd00::/8", addresses=("fd00::1",))
    assert not allowed("https://93.184.216.34/", "alarms.mill.example")
    # As C libraries read addresses.
    for text in ("http://0x7f.1/", "http://2130706433/", "http://127.1/"):
        assert not allowed(text, "127.0.0.1", "10.0.0.0/8")
    mapped = AllowedDestinations(["127.0.0.1"]).check_addresses(
        ["::ffff:127.0.0.1"], destination_of("http://127.0.0.1/")
    )
    assert mapped == ["127.0.0.1"]
    assert ipaddress.ip_address(mapped[0]).is_loopback
    for entry in ("*", "*.mill.example", "https://mill.example", "10.0.0.1/8", "300.1.1.1", "a:0", "a b", ""):
        with pytest.raises(ValidationError, match="must be names or networks"):
            ServiceSettings(webhook_destinations=[entry])
