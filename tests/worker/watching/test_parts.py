"""The parts of a watcher, without a service: looks at files, and answers that pass."""

import os
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import pytest

from sawmill_worker.watching.backoff import Backoff
from sawmill_worker.watching.durable import move, signature
from sawmill_worker.watching.fates import Fates
from sawmill_worker.watching.looks import Looks
from sawmill_worker.watching.news import News
from sawmill_worker.watching.service import Refusal, RequestFails, Service, ServiceWaits
from sawmill_worker.watching.settings import Watching
from sawmill_worker.watching.stopping import Stop
from sawmill_worker.watching.takings import Takings


def described(folder="/srv/scanner-2", service="http://127.0.0.1:8000", **changes):
    files = [{"match": "*.npy", "data": "counts"}]
    folders = [{"folder": str(folder), "scanner_id": "line-2", "files": files, **changes}]
    return Watching.model_validate({"service": service, "folders": folders})


class Clock:
    now_s = 0.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def looks(tmp_path, clock):
    return Looks(described(tmp_path).folders[0], News(), clock)


def test_a_file_is_whole_once_two_looks_far_enough_apart_see_the_same(tmp_path, looks, clock):
    path = tmp_path / "log.npy"
    path.write_bytes(b"log")
    looks.look()
    assert (looks.whole, looks.growing) == ({}, {"log.npy"})
    clock.now_s = 9.0
    looks.look()
    assert not looks.whole
    clock.now_s = 10.0
    looks.look()
    assert set(looks.whole) == {"log.npy"}


@pytest.mark.parametrize("change", ["longer", "shorter", "same length", "time put back", "another file"])
def test_any_change_begins_anew(tmp_path, looks, clock, change):
    path = tmp_path / "log.npy"
    path.write_bytes(b"12345")
    os.utime(path, ns=(0, 10**18))
    looks.look()
    clock.now_s = 9.0
    if change == "another file":
        path.unlink()
    content = {"longer": b"123456", "shorter": b"1234", "another file": b"54321", "same length": b"12354"}
    path.write_bytes(content.get(change, b"12345"))
    if change == "time put back":  # a clock that steps back, as the writer's or the share's
        os.utime(path, ns=(0, 10**17))
    looks.look()
    clock.now_s = 18.0
    looks.look()
    assert not looks.whole
    clock.now_s = 19.0
    looks.look()
    assert set(looks.whole) == {"log.npy"}


def test_an_empty_file_is_one_that_was_just_made(tmp_path, looks, clock):
    (tmp_path / "log.npy").touch()
    for clock.now_s in (0.0, 100.0, 1000.0):
        looks.look()
    assert (looks.whole, looks.growing) == ({}, {"log.npy"})


def test_marks_without_a_file_go_after_a_while(tmp_path, looks, clock):
    (tmp_path / "gone.npy.done").touch()
    (tmp_path / "log.npy").write_bytes(b"log")
    (tmp_path / "log.npy.done").touch()
    (tmp_path / ".done").touch()
    for clock.now_s in (0.0, 59.0):
        looks.look()
    assert (tmp_path / "gone.npy.done").exists()
    clock.now_s = 60.0
    looks.look()
    assert sorted(path.name for path in tmp_path.iterdir()) == [".done", "log.npy", "log.npy.done"]


def test_a_suffix_of_marks_that_is_that_of_scans_removes_none(tmp_path, clock):
    looks = Looks(described(tmp_path, done_suffix=".npy").folders[0], News(), clock)
    (tmp_path / "log.npy").write_bytes(b"log")
    for clock.now_s in (0.0, 1000.0):
        looks.look()
    assert (tmp_path / "log.npy").exists()


@pytest.fixture
def answering():
    """A server with one answer to everything."""
    servers = []

    def start(status, body, **headers):
        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                self.send_response(status)
                for name, value in {"Content-Length": str(len(body)), **headers}.items():
                    self.send_header(name.replace("_", "-"), value)
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_):
                pass

        server = HTTPServer(("127.0.0.1", 0), Handler)
        servers.append(server)
        threading.Thread(target=server.serve_forever, args=(0.01,)).start()
        return f"http://127.0.0.1:{server.server_port}"

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


@pytest.mark.parametrize(
    ("status", "body", "headers", "code", "retry_after_s"),
    [
        (429, b'{"code": "too-many-requests", "detail": "too many"}', {"Retry_After": "7"}, "too-many-requests", 7.0),
        (503, b'{"code": "stopping", "detail": "it stops"}', {"Retry_After": "999999"}, "stopping", 3600.0),
        (507, b'{"code": "storage-full", "detail": "full"}', {}, "storage-full", None),
        (401, b'{"code": "token-required", "detail": "a key"}', {}, "token-required", None),
        (409, b'{"code": "upload-quota", "detail": "later"}', {}, "upload-quota", None),
        (502, b"<html>a proxy", {"Retry_After": "Mon, 23 Nov 2026 06:00:00 GMT"}, "no-service", None),
        (200, b"<html>another program", {}, "no-service", None),
        (200, b"[]", {}, "no-service", None),
        (302, b"", {"Location": "https://elsewhere.example"}, "no-service", None),
        (404, b"not found", {}, "no-service", None),
    ],
)
def test_what_passes_is_waited_for(answering, status, body, headers, code, retry_after_s):
    with Service(described(service=answering(status, body, **headers)), Stop()) as service:
        with pytest.raises(ServiceWaits) as waits:
            service.get("/v1/scans/x")
        assert (waits.value.code, waits.value.retry_after_s) == (code, retry_after_s)


@pytest.mark.parametrize(
    ("status", "body", "code"),
    [(500, b'{"code": "internal", "detail": "a defect"}', "internal"), (413, b"<html>a proxy", "no-service")],
)
def test_what_fails_at_one_request_says_nothing_of_others(answering, status, body, code):
    with Service(described(service=answering(status, body)), Stop()) as service:
        with pytest.raises(RequestFails) as fails:
            service.get("/v1/scans/x")
        assert fails.value.code == code


@pytest.mark.parametrize(("status", "is_of_file"), [(413, True), (415, True), (404, False), (422, False)])
def test_a_refusal_is_of_the_file_or_of_what_was_asked(answering, status, is_of_file):
    with Service(described(service=answering(status, b'{"code": "c", "detail": "d"}')), Stop()) as service:
        with pytest.raises(Refusal) as refusal:
            service.get("/v1/scans/x")
        assert refusal.value.is_of_file is is_of_file


def test_waits_grow_and_keep_to_what_was_asked_for():
    backoff, waited = Backoff(), []
    for _ in range(8):
        waited.append(backoff.wait_s)
        backoff.put_off()
    assert waited == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0]
    assert not backoff.is_due
    backoff.over()
    backoff.put_off(retry_after_s=0.0)
    assert backoff.wait_s == 2.0


class Looking(type(Path())):
    """A path that notes what is looked for at it and below it."""

    looked: ClassVar[list[Path]] = []

    def exists(self, **options):
        self.looked.append(self)
        return super().exists(**options)


def test_files_of_one_name_find_their_places_without_a_look_at_all_before(tmp_path):
    folder = described(tmp_path).folders[0]
    for path in (folder.taken_folder, folder.done_folder):
        path.mkdir()
    takings = Takings(folder.path, folder.taken_folder)
    fates = Fates(SimpleNamespace(done_folder=Looking(folder.done_folder)), takings)
    for number in range(30):
        path = tmp_path / "log.npy"
        path.write_bytes(b"%d" % number)
        fates.done(takings.take("log.npy", signature(path)))
    assert 30 <= len(Looking.looked) < 4 * 30
    contents = {path.read_bytes() for path in folder.done_folder.glob("*/*.npy")}
    assert contents == {b"%d" % number for number in range(30)}


def test_a_move_that_fails_leaves_the_file_where_it_was(tmp_path):
    source = tmp_path / "log.npy"
    source.write_bytes(b"log")
    with pytest.raises(FileNotFoundError):
        move(source, tmp_path / "absent" / "log.npy")
    assert source.read_bytes() == b"log"
