"""Everything that the console offers to try works on a fresh data folder, and what it changes is an event."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from documented import check_documented
from example_requests import add_what_is_decided, with_file

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_platform.contracts.keys import KeyAsk, Scope
from sawmill_platform.contracts.uploads import UploadAsk
from sawmill_platform.uploads.upload_store import UploadQuota
from sawmill_service.app import create_app
from sawmill_service.http.document.openapi_document import write

FOLDER = Path(__file__).parents[2] / "openapi"
FILES = sorted((FOLDER / "requests").glob("*.json"))


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_committed_example_request_works(seeded, store, path):
    example = json.loads(path.read_text())
    options = options_of(seeded, example)
    add_what_is_decided(store)
    # A fresh data folder holds no key, one that nobody has would guard nothing, and no webhook, nor allows it one.
    key = store.keys.create(KeyAsk(name="example", scope=Scope.READ))
    asked = example["path"].replace("/v1/keys/example", f"/v1/keys/{key.id}")
    answer = seeded.request(example["method"], asked, **options)
    assert answer.status_code < 300, answer.text
    check_documented(answer)


def texts(folder: Path) -> dict[str, str]:
    paths = [folder / "openapi.json", *(folder / "requests").iterdir()]
    return {str(path.relative_to(folder)): path.read_text() for path in paths}


def test_what_is_committed_is_what_the_service_generates(client, tmp_path):
    (tmp_path / "requests").mkdir()
    (tmp_path / "requests/gone.json").write_text("{}")
    write(client.app, tmp_path)
    assert texts(FOLDER) == texts(tmp_path), "stale: run `make openapi`"


def test_each_operation_has_one_example_and_every_required_parameter_too(client):
    operations = [operation for item in client.app.openapi()["paths"].values() for operation in item.values()]
    assert {path.stem for path in FILES} == {operation["operationId"] for operation in operations}
    for path, item in client.app.openapi()["paths"].items():
        for operation in item.values():
            missing = [p["name"] for p in operation.get("parameters", []) if p["required"] and "example" not in p]
            assert not missing, f"{path}: {missing}"


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


def options_of(client, example):
    """What a request's query, headers and body are, as httpx is given them."""
    options = {"params": example["query"], "headers": example["headers"]}
    if example["body_file"]:
        offered = client.get(example["body_file"])
        assert offered.status_code == 200
        return options | with_file(example, offered.content)
    return options | ({"json": example["body"]} if example["media_type"] else {})


def test_every_request_that_changes_something_is_followed_by_an_event(changing, worker):
    store, every = changing.app.state.store, [json.loads(path.read_text()) for path in FILES]
    # What is made goes before what is deleted.
    examples = sorted(
        (each for each in every if each["method"] not in READ_ALONE), key=lambda each: each["method"] == "DELETE"
    )
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
