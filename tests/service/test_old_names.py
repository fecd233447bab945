"""What is out of use says so where it is used, and goes with the version that was named."""

import re
from datetime import datetime
from urllib.parse import unquote

import pytest
from contract_changes import version_tuple
from documented import check_documented

from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_platform.contracts.base import out_of_use
from sawmill_service.http.document.old_names import OLD_ROUTES
from sawmill_vocabulary.version import VERSION

PATH = "/v1/reconstructions"
HISTORY = "/v1/scanners/example/history"
FIELDS = [(declared.ask, name, mark) for declared in asked_kinds() for name, mark in out_of_use(declared.ask)]
MARKS = {f"{ask.__name__}-{name}": mark for ask, name, mark in FIELDS} | {str(each): each.mark for each in OLD_ROUTES}


def test_the_answer_to_who_uses_what_is_out_of_use_says_so(seeded, log_lines):
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


def described(seeded, answer):
    """What the link of an answer leads to."""
    address, *parameters = answer.headers["Link"].split("; ")
    assert parameters == ['rel="deprecation"', 'type="application/json"']
    path, _, pointer = address.strip("<>").partition("#/")
    assert re.fullmatch(r"[\w%/~.-]+", pointer), "RFC 3986, a fragment"
    found = seeded.get(path).json()
    for key in unquote(pointer).split("/"):
        found = found[key.replace("~1", "/").replace("~0", "~")]
    assert found["deprecated"] is True
    return found


def test_the_link_leads_to_the_field_in_the_document(seeded):
    answer = seeded.post(PATH, json={"scan_id": "example", "uncertainty": True})
    assert "no longer computed" in described(seeded, answer)["description"]
    assert {"Deprecation", "Link"} < seeded.app.openapi()["paths"][PATH]["post"]["responses"]["202"]["headers"].keys()


@pytest.mark.usefixtures("_another_is_active")
def test_an_old_route_answers_as_before_and_says_so(seeded, log_lines):
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


@pytest.mark.usefixtures("_another_is_active")
def test_an_old_route_answers_the_newest_50(seeded, store):
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
    routes = {
        f"{method.upper()} {path}"
        for path, item in document["paths"].items()
        for method, operation in item.items()
        if operation.get("deprecated")
    }
    assert routes == {str(route) for route in OLD_ROUTES}


@pytest.mark.parametrize("name", MARKS)
def test_an_old_name_works_for_a_version_and_goes_with_the_one_that_was_named(name):
    mark = MARKS[name]
    since, now, gone = map(version_tuple, (mark.since, VERSION, mark.gone_in))
    assert gone[:2] > since[:2], f"{name} must work for a version"
    assert since <= now < gone, f"take {name} out: it goes with {mark.gone_in}"
