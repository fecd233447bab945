"""Messages to real receivers on loopback, which answer well, badly, late, never or without an end."""

import asyncio
import json
import os
import re
import runpy
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import threading
from datetime import UTC, datetime, timedelta
from http.server import HTTPServer
from pathlib import Path

import httpx
import pytest
import receivers
from live_service import wait_until
from missing_parts import skip_without
from receivers import receiving, status

from sawmill_contracts import mill_events
from sawmill_platform.contracts.webhooks import WebhookRequest
from sawmill_platform.errors import StorageUnavailable
from sawmill_platform.ledger.events import announce
from sawmill_platform.settings import StorageSettings
from sawmill_platform.webhooks.outbox import LEASE
from sawmill_service.webhooks.couriers import JITTER, WAITS_S, Couriers
from sawmill_service.webhooks.destinations import AllowedDestinations
from sawmill_service.webhooks.sender import WebhookSender
from sawmill_service.webhooks.sending import WebhookSending
from sawmill_store.store import Store

LOOPBACK = AllowedDestinations(["127.0.0.0/8"])
LIMIT_S = 0.3


class GivenClock:
    def __init__(self) -> None:
        self.now = datetime.now(UTC)

    def __call__(self) -> datetime:
        return self.now

    def advance(self, seconds: float) -> None:
        self.now += timedelta(seconds=seconds)


@pytest.fixture
def clock():
    return GivenClock()


@pytest.fixture
def store(empty_data, tmp_path, clock):
    shutil.copytree(empty_data, tmp_path / "data")
    opened = Store(StorageSettings(data_folder=tmp_path / "data", database_url=None), clock=clock)
    yield opened
    opened.close()


@pytest.fixture
def receiver():
    with receiving() as one:
        yield one


@pytest.fixture
def hook(store, receiver):
    return store.webhooks.create(WebhookRequest(url=receiver.url))


def happen(store, number: int = 1) -> None:
    with store.database.write() as session:
        for k in range(number):
            announce(session, store.database.now(), mill_events.ALARM_OPENED, "scanner", f"line-{k}")


def send(store, sending: WebhookSending | None = None) -> None:
    async def look() -> None:
        couriers = Couriers(store.outbox(), sending or WebhookSending(LOOPBACK, limit_s=60.0), lambda: 1.0)
        await couriers.send_due()
        await couriers.finish()
        await couriers.stop()

    asyncio.run(look())


def test_an_event_arrives_signed_with_its_id_and_time(store, receiver, hook, clock):
    happen(store)
    clock.advance(3600)  # the attempt's own time is signed, and the event's stands in the body
    send(store)
    [message] = receiver.messages
    assert (message.path, message.headers["host"]) == ("/hook?line=2", f"127.0.0.1:{receiver.port}")
    assert message.headers["content-type"] == "application/json"
    assert message.is_signed_with(hook.secret)
    assert abs(int(message.headers["webhook-timestamp"]) - clock().timestamp()) < 1
    body = json.loads(message.body)
    assert (body["type"], body["data"]["subject_id"]) == ("alarm-opened", "line-0")
    assert datetime.fromisoformat(body["timestamp"]) == clock() - timedelta(hours=1)
    [event] = store.events.following(hook.after)
    assert body["data"] == event.model_dump(mode="json")
    [entry] = store.webhooks.deliveries(hook.id).items
    assert (entry.message_id, entry.state, entry.status) == (message.id, "delivered", 204)
    send(store)
    assert len(receiver.messages) == 1


def test_for_the_grace_both_secrets_sign_and_an_endless_body_is_not_read(store, receiver, hook):
    new = store.webhooks.rotate(hook.id, grace_s=60)
    happen(store)
    send(store)
    [message] = receiver.messages
    assert [message.is_signed_with(secret) for secret in (hook.secret, new.secret)] == [True, True]
    assert len(message.headers["webhook-signature"].split(" ")) == 2
    receiver.usual = receivers.endless
    happen(store)
    send(store, WebhookSending(LOOPBACK))
    assert store.webhooks.get(hook.id).state == "active"
    assert receiver.ended.wait(60)  # its connection was closed


@pytest.mark.parametrize(
    ("retry_after", "wait_s"),
    [("120", 120), ("1", None), ("999999999999", 86400), ("soon", None), (f"Mon, 01 Jan {10**20} 00:00:00 GMT", None)],
    ids=["seconds", "less than the schedule", "too long", "garbled", "no year"],
)
def test_a_receiver_says_when_to_come_back(store, receiver, hook, clock, retry_after, wait_s):
    receiver.usual = status(429 if retry_after == "120" else 503, Retry_After=retry_after)
    happen(store)
    send(store)
    wait = timedelta(seconds=wait_s or WAITS_S[0] * (1 + JITTER))
    assert store.webhooks.get(hook.id).next_attempt_at == clock() + wait


def test_a_date_says_when_to_come_back(store, receiver, hook, clock):
    at = datetime.now(UTC) + timedelta(minutes=10)
    receiver.usual = status(503, Retry_After=at.strftime("%a, %d %b %Y %H:%M:%S GMT"))
    happen(store)
    send(store)
    assert 590 < (store.webhooks.get(hook.id).next_attempt_at - clock()).total_seconds() < 601


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (status(302, Location="http://127.0.0.1:1/"), "it answered 302, and redirects are not followed"),
        (status(404), "it answered 404"),
        (status(410), "it answered 410"),
        (receivers.hanging, f"there was no answer within {LIMIT_S} s"),
        (receivers.dripping, f"there was no answer within {LIMIT_S} s"),
        (receivers.early_close, "what it answered is not HTTP, or the connection was closed early"),
        (receivers.garbage, "what it answered is not HTTP, or the connection was closed early"),
    ],
    ids=["redirect", "404", "gone", "hanging", "dripping", "early close", "garbage"],
)
def test_every_other_answer_is_a_failure_with_its_reason(store, receiver, hook, answer, reason):
    receiver.usual = answer
    happen(store)
    in_vain = answer in {receivers.hanging, receivers.dripping}
    send(store, WebhookSending(LOOPBACK, limit_s=LIMIT_S if in_vain else 60.0))
    stands = store.webhooks.get(hook.id)
    state = "paused" if reason.endswith("410") else "retrying"
    assert (stands.state, stands.last_failure[: len(reason)], len(receiver.messages)) == (state, reason, 1)


def test_one_that_hangs_holds_up_no_other(store, receiver, hook):
    receiver.usual = receivers.hanging
    with receiving() as other:
        store.webhooks.create(WebhookRequest(url=other.url))
        happen(store, 3)

        async def look() -> None:
            couriers = Couriers(store.outbox(), WebhookSending(LOOPBACK, limit_s=60), lambda: 0.0)
            await couriers.send_due()
            assert await asyncio.to_thread(other.has, 3)
            happen(store)
            while not await asyncio.to_thread(other.has, 4, 0.01):
                await couriers.send_due()
            await couriers.stop()  # what hangs is given up

        asyncio.run(look())
        assert len(receiver.messages) == 1
    assert store.webhooks.get(hook.id).failures == 0


def test_an_address_is_looked_up_once_an_attempt_and_checked_each_time(store, receiver):
    allowed = AllowedDestinations([f"mes.mill.example:{receiver.port}", "127.0.0.0/8"])
    hook = store.webhooks.create(WebhookRequest(url=f"http://mes.mill.example:{receiver.port}/"))
    answers, asked = [["127.0.0.1"], ["169.254.169.254"], ["127.0.0.1", "10.0.0.1"]], []

    async def rebinding(host: str, _port: int) -> list[str]:
        asked.append(host)
        return answers.pop(0)

    happen(store, 2)
    send(store, WebhookSending(allowed, resolve=rebinding))
    assert asked == ["mes.mill.example"] * 2
    [message] = receiver.messages
    assert message.headers["host"] == f"mes.mill.example:{receiver.port}"
    refused = store.webhooks.get(hook.id).last_failure
    assert refused.startswith("'mes.mill.example' leads to 169.254.169.254, which is no public address: add ")
    store.webhooks.enable(hook.id, enabled=True)
    send(store, WebhookSending(allowed, resolve=rebinding))
    assert "leads to 10.0.0.1" in store.webhooks.get(hook.id).last_failure
    assert len(receiver.messages) == 1


def test_an_address_that_swallows_everything_leaves_time_for_the_next(store, receiver):
    allowed = AllowedDestinations([f"mes.mill.example:{receiver.port}", "127.0.0.0/8"])
    store.webhooks.create(WebhookRequest(url=f"http://mes.mill.example:{receiver.port}/"))

    async def both(_host: str, _port: int) -> list[str]:
        return ["127.0.0.2", "127.0.0.1"]

    happen(store)
    # One waits to be accepted, and nobody else gets in.
    with (
        socket.create_server(("127.0.0.2", receiver.port), backlog=0) as full,
        socket.create_connection(full.getsockname()),
    ):
        send(store, WebhookSending(allowed, resolve=both, limit_s=1.0))
    assert len(receiver.messages) == 1


TOO_LONG = f"{'a' * 64}.mill.example"


@pytest.mark.parametrize(
    ("url", "allowed", "reason"),
    [
        (None, "127.0.0.2", "lies in no network that is allowed"),
        ("http://127.0.0.1:9/", "127.0.0.0/8", "the connection failed: [Errno 111] "),
        (f"https://{TOO_LONG}/", TOO_LONG, f"the name {TOO_LONG!r} cannot be resolved: it is too long"),
    ],
    ids=["no longer allowed", "nobody listening", "a name too long"],
)
def test_what_cannot_be_reached_is_a_failure_with_its_reason(store, receiver, url, allowed, reason):
    hook = store.webhooks.create(WebhookRequest(url=url or receiver.url))
    happen(store)
    send(store, WebhookSending(AllowedDestinations([allowed])))
    assert receiver.messages == []
    assert reason in store.webhooks.get(hook.id).last_failure


@pytest.mark.usefixtures("without_network")
def test_without_destinations_nothing_is_looked_up_and_no_thread_runs(store, receiver, hook):
    happen(store)
    with WebhookSender(store.outbox(), AllowedDestinations([])):
        assert "webhooks" not in {thread.name for thread in threading.enumerate()}
    send(store, WebhookSending(AllowedDestinations([])))
    assert "set SAWMILL_WEBHOOK_DESTINATIONS" in store.webhooks.get(hook.id).last_failure
    assert receiver.messages == []


@pytest.mark.usefixtures("hook")
def test_variables_of_proxies_are_passed_over(store, receiver, monkeypatch):
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    happen(store)
    send(store)
    assert len(receiver.messages) == 1


def test_tls_is_verified_by_the_name_and_not_by_the_address(store, tmp_path):
    if shutil.which("openssl") is None:
        skip_without("no openssl here to make a certificate")
    key = "-newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -keyout key.pem"
    subject = "-subj /CN=hooks.mill.example -addext subjectAltName=DNS:hooks.mill.example"
    command = f"openssl req -x509 -days 1 {key} -out certificate.pem {subject}".split()
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(tmp_path / "certificate.pem", tmp_path / "key.pem")
    named = []
    server.sni_callback = lambda _socket, name, _context: named.append(name)

    async def at_home(_host: str, _port: int) -> list[str]:
        return ["127.0.0.1"]

    def trusted() -> ssl.SSLContext:
        return ssl.create_default_context(cafile=tmp_path / "certificate.pem")

    with receiving(server) as receiver:
        hosts = [f"{name}.mill.example:{receiver.port}" for name in ("hooks", "other")]
        allowed = AllowedDestinations([*hosts, "127.0.0.1"])
        hooks, other = (store.webhooks.create(WebhookRequest(url=f"https://{host}/")) for host in hosts)
        happen(store)
        send(store, WebhookSending(allowed, resolve=at_home, certificates=trusted))
        [message] = receiver.messages
        assert message.is_signed_with(hooks.secret)
        assert sorted(named) == ["hooks.mill.example", "other.mill.example"]
        assert "certificate verify failed: Hostname mismatch" in store.webhooks.get(other.id).last_failure
        happen(store)
        send(store, WebhookSending(allowed, resolve=at_home))  # the system's store does not know it
        assert "certificate verify failed: self-signed" in store.webhooks.get(hooks.id).last_failure
        assert len(receiver.messages) == 1


def test_the_thread_of_the_service_sends_and_ends(store, receiver, hook):
    happen(store)
    with WebhookSender(store.outbox(), LOOPBACK, poll_s=0.01):
        assert receiver.has(1)
        wait_until(lambda: store.webhooks.get(hook.id).waiting == 0)
    assert store.outbox().hold()  # another process may send at once


@pytest.mark.usefixtures("hook")
def test_an_outage_of_the_database_is_a_line_of_the_log_and_not_one_a_second(store, receiver, log_lines):
    outbox, looks = store.outbox(), []
    asked = outbox.is_wanted

    def away() -> bool:
        looks.append(None)
        if len(looks) < 4:
            raise StorageUnavailable("the database does not answer")
        return asked()

    outbox.is_wanted = away
    happen(store)
    with WebhookSender(outbox, LOOPBACK, poll_s=0.01):
        assert receiver.has(1)
    assert [line["reason"] for line in log_lines() if line["event"] == "webhooks-put-off"] == [
        "the database does not answer"
    ]


SENDING = """
import sys, time
from sawmill_service.webhooks.destinations import AllowedDestinations
from sawmill_service.webhooks.sender import WebhookSender
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store
store = Store(StorageSettings(data_folder=sys.argv[1], database_url=None))
with WebhookSender(store.outbox(), AllowedDestinations(["127.0.0.1"]), poll_s=0.01):
    time.sleep(600)
"""


@pytest.mark.slow
@pytest.mark.usefixtures("hook")
def test_what_a_killed_process_had_sent_and_not_noted_is_sent_again_with_its_id(store, receiver, clock):
    receiver.usual = receivers.hanging
    happen(store, 2)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SAWMILL_")}
    with subprocess.Popen([sys.executable, "-c", SENDING, str(store.files.folder)], env=environment) as process:
        try:
            assert receiver.has(1)
        finally:
            process.send_signal(signal.SIGKILL)
    receiver.usual = status(200)
    clock.now = datetime.now(UTC)  # by which the process went
    send(store)
    assert len(receiver.messages) == 1  # the dead process's lease runs on
    clock.advance(LEASE.total_seconds())
    send(store)
    first, again, second = receiver.messages
    assert first.id == again.id != second.id
    assert first.body == again.body


ROOT = Path(__file__).parents[2]
DOCUMENT, RECEIVER = ROOT / "docs/do/webhooks.md", ROOT / "examples/clients/receive_webhooks.py"


def test_the_example_receiver_takes_what_is_signed_once_and_nothing_else(store, hook, receiver, monkeypatch, capsys):
    monkeypatch.setenv("WEBHOOK_SECRET", hook.secret)
    documented = runpy.run_path(str(RECEIVER))
    happen(store)
    send(store)
    [message] = receiver.messages
    with HTTPServer(("127.0.0.1", 0), documented["Receiver"]) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()

        def post(**changes: str | bytes) -> int:
            headers = {name: value for name, value in message.headers.items() if name.startswith("webhook-")} | changes
            url = f"http://127.0.0.1:{server.server_port}/"
            return httpx.post(url, content=message.body, headers=headers, trust_env=False).status_code

        old = str(int(message.headers["webhook-timestamp"]) - 301)
        assert ([post(), post()], post(**{"webhook-id": "another"})) == ([204, 204], 401)
        assert (post(**{"webhook-timestamp": old}), post(**{"webhook-signature": "v1,AAAA"})) == (401, 401)
        assert post(**{"webhook-signature": f"v1,AAAA {message.headers['webhook-signature']}"}) == 204
        assert post(**{"webhook-signature": b"v1,\xe4"}) == 401
        with socket.create_connection(("127.0.0.1", server.server_port), timeout=5) as line:
            line.sendall(b"POST / HTTP/1.0\r\nContent-Length: -1\r\n\r\n")
            assert line.recv(100).startswith(b"HTTP/1.0 401 ")  # at once: the body is not read to its end
        server.shutdown()
    assert capsys.readouterr().out.count("alarm-opened None") == 1


def test_attempts_follow_the_schedule_of_the_page_for_three_days_then_the_webhook_is_paused(
    store, receiver, hook, clock
):
    [waits] = re.findall(r"The waits are (.+?), each", DOCUMENT.read_text())
    units = {"s": 1, "min": 60, "h": 3600}
    assert [float(number) * units[unit] for number, unit in re.findall(r"(\d+) (\w+)", waits)] == list(WAITS_S)
    receiver.usual = status(500)
    happen(store, 2)
    begun = clock()
    for wait_s in WAITS_S:
        send(store)
        stands = store.webhooks.get(hook.id)
        wait = timedelta(seconds=wait_s * (1 + JITTER))
        assert (stands.state, stands.next_attempt_at) == ("retrying", clock() + wait)
        send(store)  # too early
        clock.advance(wait_s * (1 + JITTER) + 1)
    send(store)
    assert (len(receiver.messages), len({message.id for message in receiver.messages})) == (len(WAITS_S) + 1, 1)
    assert clock() - begun > timedelta(days=3)
    stands = store.webhooks.get(hook.id)
    assert (stands.state, stands.last_failure, stands.waiting) == ("paused", "it answered 500", 2)
    assert store.events.following(0)[-1].type == "webhook-paused"
    clock.advance(86400)
    send(store)
    assert len(receiver.messages) == len(WAITS_S) + 1
    receiver.usual = status(200)
    store.webhooks.enable(hook.id, enabled=True)
    send(store)
    resumed = [json.loads(message.body)["data"]["subject_id"] for message in receiver.messages[-2:]]
    assert resumed == ["line-0", "line-1"]
