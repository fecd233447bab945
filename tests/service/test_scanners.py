"""Scanners and their schedules over HTTP."""

import pytest
from asgi import refusal
from results import CONSTANTS
from results import SCANNER_SPEC as SPEC

BOUNDS = [
    *(("source_shift_mm", [-1e300, 500]), ("detector_to_cor_mm", [-500, 1000])),
    *(("detector_tilt", [-1, 1e6]), ("detector_shift_mm", [500, -500])),
]
TINY = [
    ("detector_pitch_mm", 1e-7, "at least 0.001, not 1e-07"),
    ("row_pitch_mm", 1e-9, "at least 0.001, not 1e-09"),
    ("source_to_cor_mm", 1e-300, "at least 1, not 1e-300"),
]


def test_a_scanner_lives_from_creation_to_deletion(client):
    created = client.post("/v1/scanners", json=SPEC)
    assert created.status_code == 201
    path = created.headers["Location"]
    assert client.get(path).json() == created.json()
    replaced = client.put(path, json={**SPEC, "name": "Line 3"})
    assert (replaced.json()["name"], replaced.json()["id"]) == ("Line 3", created.json()["id"])
    assert (client.delete(path).status_code, client.get(path).json()["code"]) == (204, "scanner-not-found")


def test_lists_are_paged_newest_first(client):
    made = [client.post("/v1/scanners", json=SPEC).json()["id"] for _ in range(5)]
    seen, after = [], {}
    while after is not None:
        page = client.get("/v1/scanners", params={"limit": 2, **after}).json()
        seen += [scanner["id"] for scanner in page["items"]]
        after = {"after": page["next"]} if page["next"] else None
    assert (seen, client.get("/v1/scanners?after=nonsense").json()["code"]) == (made[::-1], "invalid-cursor")


def test_a_watched_folder_that_is_not_allowed_is_a_problem(client, store, tmp_path):
    store.settings.watch_folders.append(tmp_path)
    watched = {"folder": str(tmp_path / "line-2"), "data": "counts", "exceptions": [{"match": "p*", "data": "counts"}]}
    made = client.post("/v1/scanners", json={**SPEC, "watched_folder": watched})
    assert made.json()["watched_folder"]["exceptions"][0]["match"] == "p*"
    for folder, code in {
        "/srv": "folder-refused",
        f"{tmp_path}/../a": "invalid-request",
        "a": "invalid-request",
    }.items():
        answer = client.post("/v1/scanners", json={**SPEC, "watched_folder": {**watched, "folder": folder}})
        assert (answer.status_code, answer.json()["code"]) == (422, code)
    assert client.put("/v1/scanners/example", json={**SPEC, "watched_folder": watched}).status_code == 404
    assert client.put(made.headers["Location"], json=SPEC).json()["watched_folder"] is None


def test_a_used_scanner_cannot_be_deleted(seeded):
    assert refusal(seeded.delete("/v1/scanners/example")) == (409, "scanner-in-use")


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        *(({"bounds": {name: bounds}}, f"body.bounds.{name}") for name, bounds in BOUNDS),
        *(
            ({"constants": CONSTANTS | {name: value}}, f"constants.{name} must be {words}")
            for name, value, words in TINY
        ),
        *(({"alarms": {"quiet_after_hours": limit}}, "alarms.quiet_after_hours") for limit in (0, -1, 1e6, "often")),
        *(
            ({"log_radius_mm": mm}, f"log_radius_mm {mm:g} must be less than constants.source_to_cor_mm 859.46")
            for mm in (859.46, 1e5)
        ),
    ],
)
def test_a_scanner_that_nobody_can_build_or_ask_for_is_a_problem(client, changes, sentence):
    answer = client.post("/v1/scanners", json={**SPEC, **changes})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid-request")
    assert sentence in answer.json()["detail"]


def test_measurements_are_listed_newest_first_from_a_time_on(seeded):
    page = seeded.get("/v1/scanners/example/measurements").json()
    assert [(one["kind"], one["subject_id"]) for one in page["items"]] == [
        ("drift", "example"),
        ("calibration", "example"),
    ]
    later = seeded.get("/v1/scanners/example/measurements", params={"since": "2999-01-01T00:00:00Z"}).json()
    assert (later, seeded.get("/v1/scanners/nobody/measurements").status_code) == ({"items": [], "next": None}, 404)
    refused = seeded.get("/v1/scanners/example/measurements", params={"since": "yesterday"})
    assert (refused.status_code, "since" in refused.text) == (422, True)


SCHEDULE = {"scanner_id": "example", "cron": "30 5 * * 1-6"}


def test_a_schedule_lives_from_creation_to_deletion(seeded):
    created = seeded.post("/v1/schedules", json=SCHEDULE)
    assert created.status_code == 201
    path = created.headers["Location"]
    assert seeded.get(path).json()["next_due_at"].endswith("05:30:00Z")
    assert seeded.put(path, json={**SCHEDULE, "time_zone": "Asia/Tokyo"}).json()["next_due_at"].endswith("20:30:00Z")
    assert seeded.put(path, json={**SCHEDULE, "enabled": False}).json()["next_due_at"] is None
    assert (seeded.get(f"{path}/runs").json(), seeded.delete(path).status_code) == ([], 204)
    assert seeded.get(path).status_code == 404
    assert {item["id"] for item in seeded.get("/v1/schedules").json()["items"]} == {"example", "example-spare"}


def test_drift_checks_are_scheduled_and_activate_nothing(seeded):
    checks = {**SCHEDULE, "kind": "check-drift", "drift_options": {"rows": "0:8"}}
    made = seeded.post("/v1/schedules", json=checks).json()
    assert (made["kind"], made["drift_options"]["rows"]) == ("check-drift", "0:8")
    assert seeded.get("/v1/schedules/example").json()["kind"] == "recalibrate"
    refused = seeded.post("/v1/schedules", json={**checks, "on_pass": "activate"})
    assert refused.status_code == 422
    assert "on_pass 'activate' belongs to kind 'recalibrate', not 'check-drift'" in refused.json()["detail"]


@pytest.mark.parametrize("cron", ["30 5 * *", "99 5 * * *", "often", "0 0 30 2 *"])
def test_a_wrong_cron_expression_is_a_problem(seeded, cron):
    answer = seeded.post("/v1/schedules", json={**SCHEDULE, "cron": cron})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid-cron")
    assert cron in answer.json()["detail"]


@pytest.mark.parametrize("zone", ["Helsinki", "europe/helsinki", "../../etc/passwd", "localtime", ""])
def test_a_wrong_time_zone_is_a_problem(seeded, zone):
    answer = seeded.post("/v1/schedules", json={**SCHEDULE, "time_zone": zone})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid-zone")
    assert f"as Europe/Helsinki or UTC, not {zone!r}" in answer.json()["detail"]
