import pytest

SPEC = {"scanner_id": "example", "cron": "30 5 * * 1-6"}


def test_a_schedule_lives_from_creation_to_deletion(seeded):
    created = seeded.post("/v1/schedules", json=SPEC)
    assert created.status_code == 201
    path = created.headers["Location"]
    assert seeded.get(path).json()["next_due_at"].endswith("05:30:00Z")
    abroad = seeded.put(path, json={**SPEC, "time_zone": "Asia/Tokyo"}).json()
    assert abroad["next_due_at"].endswith("20:30:00Z")
    paused = seeded.put(path, json={**SPEC, "enabled": False})
    assert paused.json()["next_due_at"] is None
    assert seeded.get(f"{path}/runs").json() == []
    assert seeded.delete(path).status_code == 204
    assert seeded.get(path).status_code == 404
    assert {item["id"] for item in seeded.get("/v1/schedules").json()["items"]} == {"example", "example-spare"}


def test_drift_checks_are_scheduled_and_activate_nothing(seeded):
    checks = {**SPEC, "kind": "check-drift", "drift_options": {"rows": "0:8"}}
    made = seeded.post("/v1/schedules", json=checks).json()
    assert (made["kind"], made["drift_options"]["rows"]) == ("check-drift", "0:8")
    assert seeded.get("/v1/schedules/example").json()["kind"] == "recalibrate"
    refused = seeded.post("/v1/schedules", json={**checks, "on_pass": "activate"})
    assert refused.status_code == 422
    assert "on_pass 'activate' belongs to kind 'recalibrate', not 'check-drift'" in refused.json()["detail"]


@pytest.mark.parametrize("cron", ["30 5 * *", "99 5 * * *", "often", "0 0 30 2 *"])
def test_a_wrong_cron_expression_is_a_problem(seeded, cron):
    answer = seeded.post("/v1/schedules", json={**SPEC, "cron": cron})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid-cron")
    assert cron in answer.json()["detail"]


@pytest.mark.parametrize("zone", ["Helsinki", "europe/helsinki", "../../etc/passwd", "localtime", ""])
def test_a_wrong_time_zone_is_a_problem(seeded, zone):
    answer = seeded.post("/v1/schedules", json={**SPEC, "time_zone": zone})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid-zone")
    assert f"as Europe/Helsinki or UTC, not {zone!r}" in answer.json()["detail"]
