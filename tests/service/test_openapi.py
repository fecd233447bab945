"""The OpenAPI document: its words, its examples, and what is out of use."""

import json
import re
from collections import Counter
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import unquote

import pytest
from contract_changes import version_tuple
from documented import add_what_is_decided, check_documented, with_file
from jsonschema import Draft202012Validator

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_platform.contracts.base import out_of_use
from sawmill_platform.contracts.events import Event
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_platform.contracts.uploads import UploadRequest
from sawmill_platform.settings import StorageSettings
from sawmill_platform.uploads.upload_store import UploadQuota
from sawmill_service.app import create_app
from sawmill_service.http.document.old_names import OLD_ROUTES
from sawmill_service.http.document.openapi_document import write
from sawmill_service.settings import ServiceSettings
from sawmill_service.webhooks.couriers import body_of_event
from sawmill_store.store import Store
from sawmill_vocabulary.version import VERSION

# Ends of names that state the unit.
UNITS = ("_mm", "_rad", "_deg", "_percent", "_bytes", "_s")
# How a description states what a number counts or that it has no unit.
STATED = re.compile(
    r"\bunits?\b|\bmm|1/mm|rad\b|degree|second|byte|per cent|%|[Nn]umber|count|pixel|attenuation", re.IGNORECASE
)


@pytest.fixture(scope="module")
def document(tmp_path_factory):
    store = Store.open(StorageSettings(data_folder=tmp_path_factory.mktemp("data"), database_url=None))
    yield create_app(ServiceSettings(), store, print).openapi()
    store.close()


def schemas(document):
    return document["components"]["schemas"]


def properties(document):
    for title, schema in schemas(document).items():
        for name, described in schema.get("properties", {}).items():
            yield f"{title}.{name}", name, described, described


def parameters(document):
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for parameter in operation.get("parameters", []):
                yield f"{method} {path} {parameter['name']}", parameter["name"], parameter, parameter["schema"]


def everything(document):
    yield from properties(document)
    yield from parameters(document)


def kinds(schema):
    """The types that a value may have, those of an array's items too."""
    for each in (schema, *schema.get("anyOf", []), *schema.get("prefixItems", [])):
        yield from [each.get("type")] if isinstance(each.get("type"), str) else each.get("type", [])
    if isinstance(schema.get("items"), dict):
        yield from kinds(schema["items"])


def test_names_are_short_and_choices_of_words_are_types_of_their_own(document):
    for name, schema in schemas(document).items():
        assert re.fullmatch(r"[A-Z][A-Za-z0-9]{1,29}", name), name
        assert schema.get("description"), name
    inline = [where for where, _, _, schema in everything(document) if "enum" in str(schema.get("enum", ""))]
    inline += [
        where for where, _, _, schema in everything(document) for each in schema.get("anyOf", []) if "enum" in each
    ]
    assert inline == []
    states = [where for where, name, _, schema in properties(document) if name == "state" and "JobState" in str(schema)]
    assert {"Job.state", "Drift.state", "Plan.state", "Reconstruction.state", "Inspection.state"} <= set(states)
    values = Counter(tuple(schema["enum"]) for schema in schemas(document).values() if "enum" in schema)
    assert max(values.values()) == 1


def test_every_property_and_parameter_has_a_description_a_unit_and_valid_examples(document):
    short = {where for where, _, described, _ in everything(document) if len(described.get("description", "")) < 5}
    assert {
        where for where, _, _, schema in everything(document) if where in short and "$ref" not in str(schema)
    } == set()
    for where, name, described, schema in everything(document):
        if "number" in kinds(schema) and not name.endswith(UNITS):
            assert STATED.search(described["description"]), f"{where}: {described['description']}"
    root = {"components": document["components"]}
    for where, _, _, schema in everything(document):
        validator = Draft202012Validator(schema | root, format_checker=Draft202012Validator.FORMAT_CHECKER)
        for example in schema.get("examples", []):
            assert [error.message for error in validator.iter_errors(example)] == [], where
    root = {"components": document["components"]}
    bodies = [
        part for place, part in parts(document["paths"]) if "/requestBody/content/" in place and "example" in part
    ]
    assert len(bodies) > 10
    for media in bodies:
        Draft202012Validator(media["schema"] | root).validate(media["example"])


def parts(document, place=""):
    for name, value in document.items() if isinstance(document, dict) else enumerate(document):
        if isinstance(value, dict | list):
            yield from parts(value, f"{place}/{name}")
    if isinstance(document, dict):
        yield place, document


def test_linters_and_generators_find_what_they_look_for_and_webhooks_get_what_is_described(document):
    assert (document["servers"], document["info"]["license"]["identifier"]) == ([{"url": "/"}], "Apache-2.0")
    assert document["info"]["contact"]["name"]
    assert document["paths"]["/v1/uploads/{upload_id}"]["head"]["operationId"] == "head_upload"
    tags = {tag for _, part in parts(document) for tag in part.get("tags", []) if isinstance(tag, str)}
    assert tags == {tag["name"] for tag in document["tags"]}
    assert len({re.sub("[^a-z]", "", tag.lower()) for tag in tags}) == len(tags)
    wrapped = [part for _, part in parts(document) if {"type": "null"} in part.get("anyOf", [])]
    assert all("$ref" in part["anyOf"][0] for part in wrapped)
    titled = [place for place, part in parts(document["components"]["schemas"]) if isinstance(part.get("title"), str)]
    assert [place for place in titled if "/example" not in place] == []
    pairs = [part for _, part in parts(document) if "prefixItems" in part]
    assert [pair for pair in pairs if {pair["items"]["type"]} != {item["type"] for item in pair["prefixItems"]}] == []
    assert [pair for pair in pairs if pair["maxItems"] != len(pair["prefixItems"])] == []
    # Without the items of its items openapi-python-client leaves out an array, and what contains it.
    assert [place for place, part in parts(document) if part.get("type") == "array" and "items" not in part] == []
    assert [place for place, part in parts(document) if {"minimum", "exclusiveMinimum"} <= part.keys()] == []
    names = [part["operationId"] for _, part in parts(document) if isinstance(part.get("operationId"), str)]
    assert [name for name, number in Counter(names).items() if number > 1] == []
    assert "Successful Response" not in json.dumps(document)
    message = document["webhooks"]["event"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    event = Event(number=42, at=datetime.now(UTC), type="alarm-opened", group_id="example", detail={"kind": "drift"})
    validator = Draft202012Validator(message | {"components": document["components"]})
    validator.validate(json.loads(body_of_event(event)))
    assert not validator.is_valid(event.model_dump(mode="json"))


FOLDER = Path(__file__).parents[2] / "openapi"
FILES = sorted((FOLDER / "requests").glob("*.json"))
READ_ALONE = {"GET", "HEAD"}
EVERY = [json.loads(path.read_text()) for path in FILES]
# Those that only read share a data folder; each of the others has its own.
EXAMPLES = {each["operation_id"]: [each] for each in EVERY if each["method"] not in READ_ALONE}
EXAMPLES["reading"] = [each for each in EVERY if each["method"] in READ_ALONE]


def check_head(client, path, options, got):
    """HEAD has the headers of GET; but what differs from answer to answer, or counts these requests."""
    options = {"params": options["params"], "headers": options["headers"] | {"Range": "bytes=0-1"}}
    head = client.request("HEAD", path, **options)
    assert (head.content, head.status_code) == (b"", got.status_code), path
    if path == "/v1/events":
        assert head.headers["Content-Type"] == "text/event-stream; charset=utf-8"
    elif path != "/metrics":
        given = [{**answer.headers} | {"x-request-id": "", "date": ""} for answer in (head, got)]
        assert given[0] == given[1], path


@pytest.mark.slow
@pytest.mark.parametrize("asked", EXAMPLES)
def test_the_committed_example_requests_work_and_head_is_wherever_get_is(seeded, store, asked):
    add_what_is_decided(store)
    # A fresh data folder holds no key, one that nobody has would guard nothing, and no webhook, nor allows it one.
    key = store.keys.create(KeyRequest(name="example", scope=Scope.READ))
    for example in EXAMPLES[asked]:
        path, options = example["path"].replace("/v1/keys/example", f"/v1/keys/{key.id}"), options_of(seeded, example)
        answer = seeded.request(example["method"], path, **options)
        assert answer.status_code < 300, (path, answer.text)
        check_documented(answer)
        if example["method"] == "GET":
            check_head(seeded, path, options, answer)
    nobody = "/v1/scans/nobody"
    check_head(seeded, nobody, {"params": {}, "headers": {}}, seeded.get(nobody))


def texts(folder: Path) -> dict[str, str]:
    paths = [folder / "openapi.json", *(folder / "requests").iterdir()]
    return {str(path.relative_to(folder)): path.read_text() for path in paths}


def test_what_is_committed_is_what_the_service_generates_with_one_example_an_operation(client, tmp_path):
    (tmp_path / "requests").mkdir()
    (tmp_path / "requests/gone.json").write_text("{}")
    write(client.app, tmp_path)
    assert texts(FOLDER) == texts(tmp_path), "stale: run `make openapi`"
    operations = [operation for item in client.app.openapi()["paths"].values() for operation in item.values()]
    assert {path.stem for path in FILES} == {operation["operationId"] for operation in operations}
    for path, item in client.app.openapi()["paths"].items():
        for operation in item.values():
            missing = [p["name"] for p in operation.get("parameters", []) if p["required"] and "example" not in p]
            assert not missing, f"{path}: {missing}"


QUOTA = UploadQuota(10, 2**30, 2**30)
# What each operation that changes something is followed by at least, and of what; others by what their names say.
FOLLOWED_BY = {
    "upload_phantom_picture": ("queued", "phantom"),
    "upload_scan": ("queued", "scan"),
    "activate_calibration": ("calibration-rolled-back", "calibration"),
    "acknowledge_alarm": ("alarm-acknowledged", "scanner"),
    "acknowledge_red": ("red-acknowledged", "scanner"),
    "cancel_job": ("cancelled", "calibration"),
    "inspect_file": ("queued", "inspection"),
    "measure_phantom": ("phantom-created", "phantom"),
    "rename_reconstruction": ("reconstruction-renamed", "reconstruction"),
    "mark_reconstruction": ("reconstruction-marked", "reconstruction"),
    "unmark_reconstruction": ("reconstruction-marked", "reconstruction"),
    "send_part": ("upload-complete", "upload"),
}
DONE = {"create": "created", "delete": "deleted", "discard": "discarded", "replace": "changed", "revoke": "revoked"}
DONE |= {"rotate": "rotated", "test": "tested"}


ASKED = {f"create_{declared.noun.replace('-', '_')}": declared.noun for declared in asked_kinds()}


def followed_by(operation_id: str) -> tuple[str, str]:
    verb, _, noun = operation_id.partition("_")
    return FOLLOWED_BY.get(operation_id) or (
        ("queued", ASKED[operation_id]) if operation_id in ASKED else (f"{noun}-{DONE[verb]}", noun)
    )


@pytest.fixture(params=["store", pytest.param("postgresql_store", marks=pytest.mark.nightly)])
def changing(request, seeded, settings):
    return replace(seeded, app=create_app(settings, request.getfixturevalue(request.param), [].append))


def options_of(client, example):
    options = {"params": example["query"], "headers": example["headers"]}
    if example["body_file"]:
        offered = client.get(example["body_file"])
        assert offered.status_code == 200
        return options | with_file(example, offered.content)
    return options | ({"json": example["body"]} if example["media_type"] else {})


def test_every_request_that_changes_something_is_followed_by_an_event(changing, worker):
    store = changing.app.state.store
    # What is made goes before what is deleted.
    examples = sorted(
        (each for each in EVERY if each["method"] not in READ_ALONE), key=lambda each: each["method"] == "DELETE"
    )
    another = store.calibrations.accept(CalibrationRequest(scan_id="example")).id
    replace(worker, store=store).finish_calibration()
    store.calibrations.activate(another, "by hand")
    add_what_is_decided(store)
    content = changing.get("/examples/phantom-scan.npz").content
    # Where the examples of a fresh data folder change nothing: no key, a job that has ended, a part that is not all.
    own = {
        "/v1/keys/example": f"/v1/keys/{store.keys.create(KeyRequest(name='example', scope=Scope.READ)).id}",
        "/v1/jobs/example": f"/v1/jobs/{store.calibrations.accept(CalibrationRequest(scan_id='example')).job_id}",
        "/v1/uploads/example": f"/v1/uploads/{store.uploads.create(UploadRequest(size_bytes=len(content)), QUOTA).id}",
    }
    for example in examples:
        number = store.events.newest_number()
        start = "/".join(example["path"].split("/")[:4])
        path = example["path"].replace(start, own.get(start, start))
        answer = changing.request(example["method"], path, **options_of(changing, example))
        assert answer.status_code < 300, (path, answer.text)
        happened = [(event.type, event.subject) for event in store.events.following(number)]
        assert followed_by(example["operation_id"]) in happened, (path, happened)
    upload_id = own["/v1/uploads/example"].rpartition("/")[2]
    number = store.events.newest_number()
    made = changing.post(f"/v1/inspections?upload_id={upload_id}").json()
    used = store.events.following(number)[-1]
    assert (used.type, used.subject_id) == ("upload-used", upload_id)
    assert used.detail == {"used_by": f"/v1/inspections/{made['id']}"}


def test_an_event_of_a_key_has_its_id_alone(seeded, store):
    number = store.events.newest_number()
    made = seeded.post("/v1/keys", json={"name": "line 2", "scope": "admin"}).json()
    [event] = store.events.following(number)
    announced = event.model_dump(exclude_none=True, exclude={"number", "at"})
    assert announced == {"type": "key-created", "subject": "key", "subject_id": made["id"]}


PATH = "/v1/reconstructions"
HISTORY = "/v1/scanners/example/history"
FIELDS = [(declared.ask, name, mark) for declared in asked_kinds() for name, mark in out_of_use(declared.ask)]
MARKS = {f"{ask.__name__}-{name}": mark for ask, name, mark in FIELDS} | {str(each): each.mark for each in OLD_ROUTES}


def test_an_answer_to_who_uses_what_is_out_of_use_says_so_and_links_to_the_document(seeded, log_lines):
    assert not {"Deprecation", "Link"} & {*seeded.post(PATH, json={"scan_id": "example"}).headers}
    assert not [line for line in log_lines() if line["event"] == "out-of-use"]
    used = seeded.post(PATH, json={"scan_id": "example", "uncertainty": False}, headers={"Idempotency-Key": "once"})
    check_documented(used)
    assert used.status_code == 202
    assert used.headers["Deprecation"] == f"@{int(datetime.fromisoformat('2026-11-22T00:00:00Z').timestamp())}"
    [line] = [line for line in log_lines() if line["event"] == "out-of-use"]
    assert line["fields"] == {"uncertainty": "0.3.0"}
    assert {"key_id", "request_id"} <= line.keys()
    again = seeded.post(PATH, json={"scan_id": "example", "uncertainty": False}, headers={"Idempotency-Key": "once"})
    announced = ("Deprecation", "Link", "Location")
    assert [again.headers[name] for name in announced] == [used.headers[name] for name in announced]
    answer = seeded.post(PATH, json={"scan_id": "example", "uncertainty": True})
    assert "no longer computed" in described(seeded, answer)["description"]
    assert {"Deprecation", "Link"} < seeded.app.openapi()["paths"][PATH]["post"]["responses"]["202"]["headers"].keys()


def described(seeded, answer):
    address, *parameters = answer.headers["Link"].split("; ")
    assert parameters == ['rel="deprecation"', 'type="application/json"']
    path, _, pointer = address.strip("<>").partition("#/")
    assert re.fullmatch(r"[\w%/~.-]+", pointer), "RFC 3986, a fragment"
    found = seeded.get(path).json()
    for key in unquote(pointer).split("/"):
        found = found[key.replace("~1", "/").replace("~0", "~")]
    assert found["deprecated"] is True
    return found


@pytest.mark.usefixtures("_another_is_active")
def test_an_old_route_answers_the_newest_50_as_before_and_says_so(seeded, log_lines, store):
    seeded.post("/v1/calibrations/example/activate", json={"reason": "checked"})
    answer = seeded.get(HISTORY)
    check_documented(answer)
    newest, middle, oldest = answer.json()
    assert [each["calibration_id"] for each in answer.json()] == ["example", "another", "example"]
    assert [each["activated_by"] for each in (newest, oldest)] == ["somebody at this machine", "the service"]
    assert newest["reason"] == "checked"
    assert datetime.fromisoformat(newest["activated_at"]) > datetime.fromisoformat(oldest["activated_at"])
    assert answer.headers["Deprecation"] == f"@{int(datetime.fromisoformat('2026-11-23T00:00:00Z').timestamp())}"
    assert "history/entries" in described(seeded, answer)["description"]
    [line] = [line for line in log_lines() if line["event"] == "out-of-use"]
    assert line["routes"] == {"GET /v1/scanners/{scanner_id}/history": "0.3.0"}
    assert {"key_id", "request_id"} <= line.keys()
    instead = seeded.get(f"{HISTORY}/entries", params={"kind": "activation"})
    assert not {"Deprecation", "Link"} & {*instead.headers}
    assert [entry["why"] for entry in instead.json()["items"]] == [each["reason"] for each in (newest, middle, oldest)]
    assert seeded.get("/v1/scanners/nobody/history").json()["code"] == "scanner-not-found"
    for number in range(51):
        store.calibrations.activate(("example", "another")[number % 2], f"number {number}")
    assert [each["reason"] for each in seeded.get(HISTORY).json()] == [
        f"number {number}" for number in range(50, 0, -1)
    ]


def test_the_document_has_as_deprecated_what_is_marked_and_nothing_else(seeded):
    document = seeded.app.openapi()
    flagged = {
        (title, name)
        for title, schema in document["components"]["schemas"].items()
        for name, described in schema.get("properties", {}).items()
        if described.get("deprecated")
    }
    assert {(ask.__name__, name) for ask, name, _ in FIELDS} <= flagged
    assert {name for _, name in flagged} == {name for _, name, _ in FIELDS}
    assert {
        f"{method.upper()} {path}"
        for path, item in document["paths"].items()
        for method, operation in item.items()
        if operation.get("deprecated")
    } == {str(route) for route in OLD_ROUTES}


@pytest.mark.parametrize("name", MARKS)
def test_an_old_name_works_for_a_version_and_goes_with_the_one_that_was_named(name):
    mark = MARKS[name]
    since, now, gone = map(version_tuple, (mark.since, VERSION, mark.gone_in))
    assert gone[:2] > since[:2], f"{name} must work for a version"
    assert since <= now < gone, f"take {name} out: it goes with {mark.gone_in}"
