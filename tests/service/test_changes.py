"""Whatever a request changes is an event, written with the change."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from example_requests import add_what_is_decided, with_file

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_platform.contracts.keys import KeyAsk, Scope
from sawmill_platform.contracts.uploads import UploadAsk
from sawmill_platform.uploads.upload_store import UploadQuota
from sawmill_service.app import create_app

REQUESTS = Path(__file__).parents[2] / "openapi" / "requests"
QUOTA = UploadQuota(10, 2**30, 2**30)
READ_ALONE = {"GET", "HEAD"}
# What each operation that changes something is followed by at least, and of what.
FOLLOWED_BY = {
    "upload_phantom_picture": ("queued", "phantom"),
    "upload_scan": ("queued", "scan"),
    "activate_calibration": ("calibration-rolled-back", "calibration"),
    "discard_calibration": ("calibration-discarded", "calibration"),
    "acknowledge_alarm": ("alarm-acknowledged", "scanner"),
    "cancel_job": ("cancelled", "calibration"),
    "ask_calibration": ("queued", "calibration"),
    "ask_drift": ("queued", "drift"),
    "create_key": ("key-created", "key"),
    "create_phantom": ("phantom-created", "phantom"),
    "ask_plan": ("queued", "plan"),
    "ask_reconstruction": ("queued", "reconstruction"),
    "create_scanner": ("scanner-created", "scanner"),
    "create_schedule": ("schedule-created", "schedule"),
    "create_upload": ("upload-created", "upload"),
    "delete_inspection": ("inspection-deleted", "inspection"),
    "delete_phantom": ("phantom-deleted", "phantom"),
    "delete_scan": ("scan-deleted", "scan"),
    "delete_scanner": ("scanner-deleted", "scanner"),
    "delete_schedule": ("schedule-deleted", "schedule"),
    "delete_upload": ("upload-deleted", "upload"),
    "inspect_file": ("queued", "inspection"),
    "measure_phantom": ("phantom-created", "phantom"),
    "name_reconstruction": ("reconstruction-renamed", "reconstruction"),
    "replace_scanner": ("scanner-changed", "scanner"),
    "replace_schedule": ("schedule-changed", "schedule"),
    "replace_retention": ("retention-changed", "retention"),
    "revoke_key": ("key-revoked", "key"),
    "rotate_key": ("key-rotated", "key"),
    "send_part": ("upload-complete", "upload"),
    "create_webhook": ("webhook-created", "webhook"),
    "replace_webhook": ("webhook-changed", "webhook"),
    "rotate_webhook": ("webhook-rotated", "webhook"),
    "test_webhook": ("webhook-tested", "webhook"),
    "delete_webhook": ("webhook-deleted", "webhook"),
}


@pytest.fixture(params=["store", pytest.param("postgresql_store", marks=pytest.mark.nightly)])
def changing(request, seeded, settings):
    """A client of a service with the examples, on each database in turn."""
    return replace(seeded, app=create_app(settings, request.getfixturevalue(request.param), [].append))


def changing_requests():
    every = [json.loads(path.read_text()) for path in sorted(REQUESTS.glob("*.json"))]
    # What is made goes before what is deleted.
    return sorted(
        (each for each in every if each["method"] not in READ_ALONE), key=lambda each: each["method"] == "DELETE"
    )


def options_of(client, example):
    options = {"params": example["query"], "headers": example["headers"]}
    if example["body_file"]:
        return options | with_file(example, client.get(example["body_file"]).content)
    return options | ({"json": example["body"]} if example["media_type"] else {})


def test_every_request_that_changes_something_is_followed_by_an_event(changing, worker):
    store, examples = changing.app.state.store, changing_requests()
    add_what_is_decided(store)
    another = store.calibrations.accept(CalibrationAsk(scan_id="example")).id
    replace(worker, store=store).finish_calibration()
    store.calibrations.activate(another, "by hand")
    assert {each["operation_id"] for each in examples} == set(FOLLOWED_BY), "name the event of each operation"
    content = changing.get("/examples/phantom-scan.npz").content
    # Where the examples of a fresh data folder change nothing: no key, a job that has ended, a part that is not all.
    own = {
        "/v1/keys/example": f"/v1/keys/{store.keys.create(KeyAsk(name='example', scope=Scope.READ)).id}",
        "/v1/jobs/example": f"/v1/jobs/{store.calibrations.accept(CalibrationAsk(scan_id='example')).job_id}",
        "/v1/uploads/example": f"/v1/uploads/{store.uploads.create(UploadAsk(size_bytes=len(content)), QUOTA).id}",
    }
    for example in examples:
        number = store.events.newest_number()
        start = "/".join(example["path"].split("/")[:4])
        path = example["path"].replace(start, own.get(start, start))
        answer = changing.request(example["method"], path, **options_of(changing, example))
        assert answer.status_code < 300, (path, answer.text)
        happened = [(event.what, event.subject) for event in store.events.following(number)]
        assert FOLLOWED_BY[example["operation_id"]] in happened, (path, happened)
    upload_id = own["/v1/uploads/example"].rpartition("/")[2]
    number = store.events.newest_number()
    made = changing.post(f"/v1/inspections?upload_id={upload_id}").json()
    used = store.events.following(number)[-1]
    assert (used.what, used.subject_id) == ("upload-used", upload_id)
    assert used.detail == {"used_by": f"/v1/inspections/{made['id']}"}


def test_an_event_of_a_key_has_its_id_alone(seeded, store):
    number = store.events.newest_number()
    made = seeded.post("/v1/keys", json={"name": "line 2", "scope": "admin"}).json()
    [event] = store.events.following(number)
    assert event.model_dump(exclude_none=True, exclude={"number", "at"}) == {
        "what": "key-created",
        "subject": "key",
        "subject_id": made["id"],
    }
