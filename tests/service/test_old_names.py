"""What is out of use says so where it is used, and goes with the version that was named."""

from datetime import datetime
from pathlib import Path

import pytest
from contract_changes import version_tuple
from documented import check_documented

from sawmill_service.old_names import markdown_table
from sawmill_worker.contracts.kinds import asked_kinds
from sawmill_worker.contracts.old_names import out_of_use
from sawmill_worker.contracts.reconstructions import ReconstructionAsk
from sawmill_worker.vocabulary.version import VERSION

PAGE = Path(__file__).parents[2] / "docs/http.md"
PATH = "/v1/reconstructions"
EVERY = [(declared.ask, name, mark) for declared in asked_kinds() for name, mark in out_of_use(declared.ask)]


def test_the_answer_to_who_uses_what_is_out_of_use_says_so(seeded, log_lines):
    plain = seeded.post(PATH, json={"scan_id": "example"})
    assert not {"Deprecation", "Link"} & {*plain.headers}
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


def test_the_link_leads_to_the_field_in_the_document(seeded):
    answer = seeded.post(PATH, json={"scan_id": "example", "uncertainty": True})
    address, *parameters = answer.headers["Link"].split("; ")
    assert parameters == ['rel="deprecation"', 'type="application/json"']
    path, _, pointer = address.strip("<>").partition("#/")
    found = seeded.get(path).json()
    for key in pointer.split("/"):
        found = found[key]
    assert found["deprecated"] is True
    assert "no longer computed" in found["description"]
    headers = seeded.app.openapi()["paths"][PATH]["post"]["responses"]["202"]["headers"]
    assert {"Deprecation", "Link"} < headers.keys()


def test_the_document_has_as_deprecated_what_is_marked_and_nothing_else(seeded):
    schemas = seeded.app.openapi()["components"]["schemas"]
    flagged = {
        (title, name)
        for title, schema in schemas.items()
        for name, described in schema.get("properties", {}).items()
        if described.get("deprecated")
    }
    assert {(ask.__name__, name) for ask, name, _ in EVERY} <= flagged
    assert {name for _, name in flagged} == {name for _, name, _ in EVERY}


@pytest.mark.parametrize(("ask", "name", "mark"), EVERY, ids=[f"{ask.__name__}-{name}" for ask, name, _ in EVERY])
def test_an_old_name_works_for_a_version_and_goes_with_the_one_that_was_named(ask, name, mark):
    since, now, gone = map(version_tuple, (mark.since, VERSION, mark.gone_in))
    assert gone[:2] > since[:2], f"{name} must work for a version"
    assert since <= now < gone, f"take {name} out of {ask.__name__}: it goes with {mark.gone_in}"


def test_the_page_lists_them():
    assert markdown_table() in PAGE.read_text(), "put what `python -m sawmill_service.old_names` prints into it"


def test_it_is_found_by_its_mark():
    assert dict(out_of_use(ReconstructionAsk)).keys() == {"uncertainty"}
