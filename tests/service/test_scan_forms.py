"""POST /v1/scans/form: a scan as a form, by httpx and by bytes of any shape."""

import asyncio
import gzip
import hashlib
import threading
from base64 import b64encode

import httpx
import numpy as np
import pytest
from documented import check_documented
from pydantic import SecretStr
from starlette.datastructures import Headers

from sawmill_contracts import job_kinds
from sawmill_platform.files.upload_stream import PART_BYTES
from sawmill_service.app import create_app
from sawmill_service.http.bodies.sent_content import SentContent
from sawmill_service.http.bodies.sent_form import SentForm
from sawmill_service.http.session_cookie import csrf_token
from sawmill_service.routes.scan_forms import ScanForm
from sawmill_store.store import Store

FORM = "/v1/scans/form"
CONTENT = np.random.default_rng(15).bytes(3000) + b"\r\n--x\r\n--xx\r\r\n--x-\r\n-" + bytes(range(256))
FIELDS = {"scanner_id": "example", "data": "counts"}
TYPE = {"Content-Type": "multipart/form-data; boundary=xyz"}


def part(name, value, head=""):
    value = value if isinstance(value, bytes) else value.encode()
    return f'--xyz\r\nContent-Disposition: form-data; name="{name}"{head}\r\n\r\n'.encode() + value + b"\r\n"


FILE = part("file", CONTENT, '; filename="mill.npz"')
GIVEN = part("scanner_id", "example") + part("data", "counts")
END = b"--xyz--\r\n"


def incoming(store):
    return [path.name for path in (store.files.folder / "incoming").iterdir()]


def send(client, body, **headers):
    answer = client.post(FORM, content=body, headers={**TYPE, **headers})
    check_documented(answer)
    return answer


async def in_pieces(body, *cuts):
    for begin, end in zip([0, *cuts], [*cuts, len(body)], strict=True):
        yield body[begin:end]


async def until_the_file(fields):
    """The fields and the file's beginning; then nobody may ask for more than the one part that comes meanwhile."""
    yield fields + part("file", bytes(PART_BYTES), '; filename="mill.npz"')
    yield bytes(PART_BYTES)
    raise AssertionError("more was asked for")


async def untouchable():
    raise AssertionError("a byte of the body was asked for")
    yield b""


def kept(store, scan):
    return store.files.upload(job_kinds.INGEST, scan["id"]).read_bytes()


@pytest.mark.parametrize("fields_first", [True, False])
def test_a_form_becomes_a_scan_whatever_stands_first(seeded, store, woken, fields_first):
    fields = [(name, (None, value)) for name, value in {**FIELDS, "phantom_id": "l-shape", "rings": "sorting"}.items()]
    file = [("file", ("folder/week 10.npz", CONTENT))]
    answer = seeded.post(FORM, files=fields + file if fields_first else file + fields)
    check_documented(answer)
    scan = answer.json()
    assert (answer.status_code, answer.headers["location"]) == (202, f"/v1/scans/{scan['id']}")
    assert (scan["scanner_id"], scan["phantom_id"], scan["rings"]) == ("example", "l-shape", "sorting")
    assert (scan["name"], scan["sha256"]) == ("week 10.npz", hashlib.sha256(CONTENT).hexdigest())
    assert kept(store, scan) == CONTENT
    assert woken == [scan["job_id"]]


def test_a_name_that_is_given_stands_before_the_files_own(seeded):
    files = {"file": ("C:\\scans\\mill.h5", CONTENT)}
    assert seeded.post(FORM, data=FIELDS, files=files).json()["name"] == "mill.h5"
    assert seeded.post(FORM, data={**FIELDS, "name": "mine"}, files=files).json()["name"] == "mine"
    assert send(seeded, GIVEN + part("file", CONTENT) + END).json()["name"] == "scan"


@pytest.mark.parametrize(
    ("sent", "name"),
    [
        (b"week\xff 10.npz", "week\ufffd 10.npz"),
        (b" a\0\x1f\xe2\x80\xaeb ", "ab"),
        (b"a" * 300, "a" * 200),
        (b"\t/ \x7f", "scan"),
    ],
)
def test_a_files_name_is_made_to_fit(seeded, sent, name):
    body = GIVEN + part("file", CONTENT, '; filename="a name"').replace(b"a name", sent)
    assert send(seeded, body + END).json()["name"] == name
    assert send(seeded, body + part("name", "mine") + END).json()["name"] == "mine"


@pytest.mark.slow
def test_forms_and_repeats_that_last_keep_nobody_else_waiting(seeded, settings, store, monkeypatch):
    """More of each than the service has threads: uploads and requests without a body are served meanwhile."""
    seeded.app = create_app(settings.model_copy(update={"max_bodies_at_once": 1000}), store, print)
    scans, packed = "/v1/scans?scanner_id=example&data=counts", {"Content-Encoding": "gzip"}
    keyed, slow = packed | {"Idempotency-Key": "once"}, gzip.compress(CONTENT)
    assert seeded.post(scans, content=slow, headers=keyed).status_code == 202
    held, take = threading.Event(), SentContent.take

    def take_later(body, part):
        """Take long over all but the plain file."""
        assert part == CONTENT or held.wait(120)
        yield from take(body, part)

    monkeypatch.setattr(SentContent, "take", take_later)
    begun, all_begun = [], asyncio.Event()

    async def counted(body):
        begun.append(body)
        if len(begun) == 90:
            all_begun.set()
        yield body

    async def send_all():
        """One event loop, as in the service: its threads are those that all requests share."""
        transport = httpx.ASGITransport(seeded.app)
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1:8000", timeout=120) as client:
            repeats = [asyncio.create_task(client.post(scans, content=counted(slow), headers=keyed)) for _ in range(45)]
            body = GIVEN + FILE + END
            forms = [asyncio.create_task(client.post(FORM, content=counted(body), headers=TYPE)) for _ in range(45)]
            try:
                async with asyncio.timeout(120):
                    await all_begun.wait()
                    other = await client.post(scans, content=CONTENT)
                waited = not any(task.done() for task in repeats + forms)
            finally:
                held.set()
            return other, waited, await asyncio.gather(*repeats), await asyncio.gather(*forms)

    other, waited, repeats, forms = asyncio.run(send_all())
    assert (other.status_code, waited) == (202, True), other.text
    assert {answer.headers.get("Idempotency-Replayed") for answer in repeats} == {"true"}
    assert {answer.status_code for answer in forms} == {202}


def test_a_form_as_dotnet_writes_it_is_taken(seeded, store):
    body = (
        b"--5c9d-01\r\nContent-Type: text/plain; charset=utf-8\r\n"
        b"Content-Disposition: form-data; name=scanner_id\r\n\r\n"
        b"example\r\n--5c9d-01\r\nContent-Type: text/plain; charset=utf-8\r\n"
        b"Content-Disposition: form-data; name=data\r\n\r\ncounts\r\n--5c9d-01\r\n"
        b"Content-Disposition: form-data; name=file; filename=mill.h5; filename*=utf-8''mill.h5\r\n\r\n"
        + CONTENT
        + b"\r\n--5c9d-01--\r\n"
    )
    scan = send(seeded, body, **{"Content-Type": 'multipart/form-data; boundary="5c9d-01"'}).json()
    assert (scan["name"], kept(store, scan)) == ("mill.h5", CONTENT)


CUT = GIVEN + part("file", b"\r\n--xyzz\r\n--xy\r\n", '; filename="a"') + part("name", "cut") + END


def check_cut(seeded, store, cut):
    scan = send(seeded, in_pieces(CUT, cut)).json()
    assert kept(store, scan) == b"\r\n--xyzz\r\n--xy\r\n", cut
    assert scan["name"] == "cut"


def test_a_form_may_be_cut_at_any_of_40_drawn_positions(seeded, store):
    for cut in np.random.default_rng(17).choice(np.arange(1, len(CUT)), 40, replace=False).tolist():
        check_cut(seeded, store, cut)


@pytest.mark.nightly
def test_a_form_may_be_cut_anywhere(seeded, store):
    for cut in range(1, len(CUT)):
        check_cut(seeded, store, cut)


def test_a_form_in_pieces_of_a_byte_is_taken_bit_for_bit():
    form, body = SentForm(Headers(TYPE), ScanForm, max_field_bytes=1000), GIVEN + FILE + END
    taken = [piece for begin in range(len(body)) for piece in form.take(body[begin : begin + 1])]
    form.end()
    assert b"".join(taken) == CONTENT
    assert (form.form.scanner_id, form.form.name) == ("example", "mill.npz")


MANY = b"".join(part(f"field{number}", "1") for number in range(10_000))
REFUSED = {
    "no boundary": (GIVEN + FILE + END, {"Content-Type": "multipart/form-data"}, 400, "bad-form"),
    "another boundary": (
        (GIVEN + FILE + END).replace(b"--xyz", b"--abc"),
        {},
        400,
        "bad-form",
    ),
    "no form": (GIVEN + FILE + END, {"Content-Type": "application/octet-stream"}, 415, "unsupported-media-type"),
    "packed": (gzip.compress(GIVEN + FILE + END), {"Content-Encoding": "gzip"}, 415, "unsupported-encoding"),
    "no last boundary": (GIVEN + FILE, {}, 400, "bad-form"),
    "broken off in the file": ((GIVEN + FILE)[:-30], {}, 400, "bad-form"),
    "half of the last boundary": (GIVEN + FILE + END[:5], {}, 400, "bad-form"),
    "broken off in a part's head": (GIVEN + FILE[:40], {}, 400, "bad-form"),
    "a packed part": (
        GIVEN + part("file", gzip.compress(CONTENT), "\r\nContent-Encoding: gzip") + END,
        {},
        415,
        "unsupported-encoding",
    ),
    "a header twice": (
        GIVEN + part("file", CONTENT, '\r\nContent-Disposition: form-data; name="name"') + END,
        {},
        400,
        "bad-form",
    ),
    "a form in a form": (
        GIVEN + part("file", (GIVEN + END).replace(b"xyz", b"abc"), '; filename="a"') + END,
        {},
        415,
        "unsupported-media-type",
    ),
    "nothing": (b"", {}, 422, "empty-body"),
    "no file": (GIVEN + END, {}, 422, "invalid-request"),
    "an empty file": (GIVEN + part("file", "", '; filename=""') + END, {}, 422, "empty-body"),
    "two files": (GIVEN + FILE + FILE + END, {}, 422, "two-files"),
    "a field twice": (GIVEN + part("data", "counts") + FILE + END, {}, 422, "invalid-request"),
    "10 000 parts": (MANY + GIVEN + FILE + END, {}, 400, "bad-form"),
    "a head of 1 MB": (part("file", CONTENT, "; a=" + "x" * 10**6) + END, {}, 400, "bad-form"),
    "a part without a name": (GIVEN + b"--xyz\r\nX: y\r\n\r\n1\r\n" + FILE + END, {}, 400, "bad-form"),
    "a large field": (part("angles_deg", "1," * 2**19 + "1") + GIVEN + FILE + END, {}, 413, "body-too-large"),
    "a page": (GIVEN + part("file", "<!doctype html><p>", '; filename="a"') + END, {}, 415, "unsupported-media-type"),
    "a page by its type": (
        GIVEN + part("file", CONTENT, "\r\nContent-Type: text/html") + END,
        {},
        415,
        "unsupported-media-type",
    ),
    "base64": (
        GIVEN + part("file", b64encode(CONTENT), "\r\nContent-Transfer-Encoding: base64") + END,
        {},
        415,
        "unsupported-encoding",
    ),
    "bytes as a field": (part("name", b"\xff\xfe") + GIVEN + FILE + END, {}, 400, "bad-form"),
    "an unknown scanner": (
        part("scanner_id", "no") + part("data", "counts") + FILE + END,
        {},
        404,
        "scanner-not-found",
    ),
    "another digest": (
        GIVEN + FILE + END,
        {"Content-Digest": f"sha-256=:{b64encode(bytes(32)).decode()}:"},
        400,
        "digest-mismatch",
    ),
    "a large file": (GIVEN + part("file", bytes(50_001)) + END, {}, 413, "upload-too-large"),
}


@pytest.mark.parametrize(("body", "headers", "status", "code"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused_leaves_nothing(seeded, settings, store, body, headers, status, code):
    limits = {"max_form_bytes": 50_000, "max_json_bytes": 2**20}
    seeded.app = create_app(settings.model_copy(update=limits), store, print)
    scans = len(seeded.get("/v1/scans").json()["items"])
    answer = send(seeded, body, **headers)
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert incoming(store) == []
    assert len(seeded.get("/v1/scans").json()["items"]) == scans


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"scanner_id": "nowhere", "data": "counts"}, "scanner-not-found"),
        ({**FIELDS, "phantom_id": "nothing"}, "phantom-not-found"),
        ({"data": "guess"}, "invalid-request"),
        ({"fantom_id": "l-shape"}, "invalid-request"),
    ],
)
def test_fields_before_the_file_are_looked_up_before_it_is_received(seeded, store, settings, fields, code):
    seeded.app = create_app(settings.model_copy(update={"max_upload_bytes": 2**22}), store, print)
    answer = send(seeded, until_the_file(b"".join(part(name, value) for name, value in fields.items())))
    assert answer.json()["code"] == code
    assert incoming(store) == []


@pytest.mark.parametrize(
    ("headers", "status", "code"),
    [
        ({"Content-Type": "application/x-www-form-urlencoded"}, 415, "unsupported-media-type"),
        ({"Content-Encoding": "gzip"}, 415, "unsupported-encoding"),
        ({"Content-Digest": "what?"}, 400, "bad-digest"),
        ({"Content-Length": str(2**27)}, 413, "body-too-large"),
        ({"Idempotency-Key": "two words"}, 400, "bad-idempotency-key"),
        ({"Authorization": "Bearer nobody"}, 401, "token-required"),
    ],
)
def test_what_the_head_tells_is_refused_before_a_byte_is_read(seeded, store, headers, status, code):
    answer = send(seeded, untouchable(), **headers)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert incoming(store) == []


def test_a_full_disk_is_answered_before_a_byte_is_read(seeded, settings, store):
    full = Store(store.settings.model_copy(update={"disk_reserve_bytes": 2**62}))
    seeded.app = create_app(settings, full, print)
    assert send(seeded, untouchable()).json()["code"] == "storage-full"
    full.close()


def test_a_form_of_unknown_length_ends_at_the_limit(seeded, settings, store):
    seeded.app = create_app(
        settings.model_copy(update={"max_form_bytes": 2**20, "max_upload_bytes": 2**30}), store, print
    )

    async def endless():
        yield GIVEN + part("file", b"scan", '; filename="a"')[:-2]
        for _ in range(100):
            yield bytes(2**18)
        raise AssertionError("more was asked for")

    answer = send(seeded, endless())
    assert (answer.status_code, answer.json()["code"]) in {(413, "upload-too-large"), (413, "body-too-large")}
    assert incoming(store) == []
    exact = send(seeded, GIVEN + part("file", bytes(2**20)) + END)
    assert (exact.status_code, exact.json()["size_bytes"]) == (202, 2**20)


def test_a_body_that_is_shorter_than_its_length_leaves_nothing(seeded, store):
    body = GIVEN + FILE + END
    answer = send(seeded, in_pieces(body), **{"Content-Length": str(len(body) + 1)})
    assert (answer.status_code, answer.json()["code"]) == (400, "bad-length")
    assert incoming(store) == []


def test_errors_name_their_field(seeded):
    answer = send(seeded, GIVEN + part("fantom_id", "l-shape") + FILE + END).json()
    assert answer["detail"] == "body.fantom_id is not a known field"
    assert answer["errors"][0]["pointer"] == "#/fantom_id"
    missing = send(seeded, part("name", "mine") + END).json()
    assert [each["pointer"] for each in missing["errors"]] == ["#/data", "#/scanner_id", "#/file"]
    assert {each["message"] for each in missing["errors"]} == {"is required"}


def test_a_digest_is_of_the_whole_body(seeded):
    body = GIVEN + FILE + END
    right = {"Content-Digest": f"sha-256=:{b64encode(hashlib.sha256(body).digest()).decode()}:"}
    assert send(seeded, body, **right).status_code == 202
    assert send(seeded, body + b"\r\n", **right).json()["code"] == "digest-mismatch"


def test_a_repeat_makes_nothing_again_whatever_its_boundary(seeded, store, woken):
    first = seeded.post(FORM, data=FIELDS, files={"file": CONTENT}, headers={"Idempotency-Key": "once"})
    again = seeded.post(
        FORM,
        files=[("file", CONTENT), *((name, (None, value)) for name, value in reversed(FIELDS.items()))],
        headers={"Idempotency-Key": "once"},
    )
    check_documented(again)
    assert (again.status_code, again.content) == (202, first.content)
    assert again.headers["Idempotency-Replayed"] == "true"
    assert len(woken) == 1
    for fields, content in (({**FIELDS, "name": "other"}, CONTENT), (FIELDS, CONTENT + b"\0")):
        other = seeded.post(FORM, data=fields, files={"file": content}, headers={"Idempotency-Key": "once"})
        assert (other.status_code, other.json()["code"]) == (422, "idempotency-key-reused")
    assert incoming(store) == []


def test_what_was_refused_may_be_mended_under_the_same_key(seeded):
    key = {"Idempotency-Key": "mended"}
    assert send(seeded, GIVEN + FILE, **key).json()["code"] == "bad-form"
    assert send(seeded, GIVEN + FILE + END, **key).status_code == 202


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example", "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"},
        {"Origin": "http://127.0.0.1:9000"},
    ],
)
def test_a_form_of_another_site_makes_nothing_on_loopback(seeded, headers):
    """A browser asks nobody before it sends a form elsewhere, and on loopback no key is needed."""
    answer = send(seeded, untouchable(), **headers)
    assert (answer.status_code, answer.json()["code"]) == (403, "other-site")
    own = {"Origin": "http://127.0.0.1:8000", "Sec-Fetch-Site": "same-origin"}
    assert send(seeded, GIVEN + FILE + END, **own).status_code == 202


def test_a_session_needs_its_token_beside_the_cookie(seeded, store, settings):
    token = "t" * 40
    seeded.app = create_app(settings.model_copy(update={"token": SecretStr(token)}), store, print)
    login = seeded.post("/login", data={"key": token}, headers={"Origin": "http://127.0.0.1:8000"})
    cookie = login.headers["Set-Cookie"].partition(";")[0]
    session = {"Cookie": cookie, "Origin": "http://127.0.0.1:8000"}
    assert send(seeded, untouchable(), **session).json()["code"] == "csrf"
    in_body = part("csrf", csrf_token(cookie.partition("=")[2]))
    assert send(seeded, in_body + GIVEN + FILE + END, **session).json()["code"] == "csrf"
    named = {"X-CSRF-Token": csrf_token(cookie.partition("=")[2])}
    assert send(seeded, GIVEN + FILE + END, **session, **named).status_code == 202
