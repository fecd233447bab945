"""Who did what: every route that decides or removes leaves an entry with the key's name."""

import json

import pytest
from results import SCANNER_SPEC as SPEC
from typer.testing import CliRunner

from sawmill_command.commands import main
from sawmill_contracts import mill_events
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.keys import Scope
from sawmill_service.app import create_app
from sawmill_service.settings import ServiceSettings

DISC = {"name": "disc", "shapes": [{"kind": "disc", "center_mm": [0, 0], "radius_mm": 50}]}
SCHEDULE = {"scanner_id": "example", "cron": "30 5 * * 1-6", "enabled": False}


@pytest.fixture
def anna(seeded, store):
    """A client who brings the key of an administrator."""
    seeded.app = create_app(ServiceSettings(public_url="https://calibration.mill.example"), store, print)
    seeded.key = seeded.bring(Scope.ADMIN, name="anna")
    return seeded


@pytest.mark.usefixtures("_another_is_active")
def test_every_decision_is_entered_with_who_made_it(anna, store):
    before = store.audit.page().items[0].number
    scanner = anna.post("/v1/scanners", json=SPEC).json()["id"]
    looser = SPEC | {"tolerances": {"predicted_ray_error_mm": 5.0}}
    anna.put(f"/v1/scanners/{scanner}", json=looser)
    anna.delete(f"/v1/scanners/{scanner}")
    schedule = anna.post("/v1/schedules", json=SCHEDULE).json()["id"]
    anna.put(f"/v1/schedules/{schedule}", json=SCHEDULE | {"on_pass": "activate"})
    anna.delete(f"/v1/schedules/{schedule}")
    anna.post("/v1/calibrations/example/activate", json={"reason": "checked by hand"})
    job = anna.post("/v1/calibrations", json={"scan_id": "example"}).json()["job_id"]
    anna.post(f"/v1/jobs/{job}/cancel")
    anna.post(f"/v1/jobs/{job}/cancel")  # has ended: nobody does anything
    anna.delete("/v1/scans/example")
    phantom = anna.post("/v1/phantoms", json=DISC).json()["id"]
    anna.delete(f"/v1/phantoms/{phantom}")
    entries = [entry for entry in store.audit.all() if entry.number > before]
    assert [entry.action for entry in entries] == [
        mill_events.SCANNER_CREATED,
        mill_events.SCANNER_CHANGED,
        mill_events.SCANNER_DELETED,
        mill_events.SCHEDULE_CREATED,
        mill_events.SCHEDULE_CHANGED,
        mill_events.SCHEDULE_DELETED,
        mill_events.CALIBRATION_ROLLED_BACK,
        event_kinds.JOB_CANCELLED,
        mill_events.SCAN_DELETED,
        mill_events.PHANTOM_DELETED,
    ]
    assert {(entry.who, entry.key_id, entry.address) for entry in entries} == {("anna", anna.key.id, "127.0.0.1")}
    was, now = entries[1].detail["tolerances"]
    assert (was["predicted_ray_error_mm"], now["predicted_ray_error_mm"]) == (0.1, 5.0)
    assert entries[4].detail == {"on_pass": ["report", "activate"]}
    assert entries[6].detail == {"scanner_id": "example", "reason": "checked by hand"}


def test_what_is_refused_leaves_no_entry(anna, store):
    before = store.audit.page().items
    assert anna.delete("/v1/scanners/example").status_code == 409
    assert anna.put("/v1/scanners/nobody", json=SPEC).status_code == 404
    assert (anna.delete("/v1/phantoms/l-shape").status_code, store.audit.page().items) == (409, before)


def test_a_calibration_that_activates_itself_names_the_key_that_asked(anna, store, worker):
    anna.post("/v1/calibrations", json={"scan_id": "example", "activate": True})
    worker.finish_calibration()
    newest = store.audit.page(limit=1).items[0]
    assert (newest.action, newest.who, newest.key_id) == (mill_events.CALIBRATION_ACTIVATED, "anna", anna.key.id)
    assert "the request asked for activation on pass" in newest.detail["reason"]


def test_the_audit_is_read_over_http_and_as_a_file(anna, store, tmp_path):
    anna.delete("/v1/scans/example")
    entries = list(store.audit.all())
    first = anna.get("/v1/audit?limit=1").json()
    assert first["items"][0]["number"] == entries[-1].number
    following = anna.get("/v1/audit", params={"after": first["next"]}).json()["items"]
    assert [item["number"] for item in following] == [entry.number for entry in reversed(entries[:-1])]
    answer = anna.get("/v1/audit.jsonl")
    assert answer.headers["Content-Type"] == "application/jsonl"
    lines = [json.loads(line) for line in answer.text.splitlines()]
    assert lines == [entry.model_dump(mode="json") for entry in entries]
    out = tmp_path / "audit.jsonl"
    done = CliRunner().invoke(main, ["audit", "--data", str(store.files.folder), "--output", str(out)])
    assert (done.exit_code, out.read_text()) == (0, answer.text)
