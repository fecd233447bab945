"""What is asked of a scan or a phantom: accepted, waited for, answered with links that lead somewhere, and listed."""

import pytest

from sawmill_contracts import kinds

PLANS = "/v1/phantoms/l-shape/plans"
LINKS = ("volume", "first_slice", "mosaic", "side")


@pytest.mark.parametrize(
    ("kind", "path", "ask", "known", "without"),
    [
        ("drift", "/v1/drifts", {"scan_id": "example", "rows": "0:2"}, ("calibration_id", "example"), ()),
        (
            "reconstruction",
            "/v1/reconstructions",
            {"scan_id": "example", "size": 32},
            ("calibration_id", "example"),
            LINKS,
        ),
        ("plan", PLANS, {"scanner_id": "example", "views": 20}, ("phantom_id", "l-shape"), ()),
        # Its report takes seconds to draw.
        pytest.param(
            *(
                "calibration",
                "/v1/calibrations",
                {"scan_id": "example", "seed": 11},
                ("phantom_id", "l-shape"),
                ["report"],
            ),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_it_is_accepted_waited_for_and_answered(seeded, worker, woken, kind, path, ask, known, without):
    accepted = seeded.post(path, json=ask)
    assert (accepted.status_code, accepted.headers["Retry-After"]) == (202, "1")
    address = accepted.headers["Location"]
    queued = seeded.get(address).json()
    assert (queued["state"], woken, queued[known[0]]) == ("queued", [queued["job_id"]], known[1])
    name, value = list(ask.items())[-1]
    assert queued["options"][name] == value
    for link in without:
        assert seeded.get(queued["links"][link]).json()["code"] == f"{kind}-without-result"
    getattr(worker, f"finish_{kind}")()
    answer = seeded.get(address).json()
    assert answer["state"] == "succeeded"
    for link in answer["links"].values():
        assert seeded.get(link).status_code == 200


def test_its_answer_has_the_job_s_result(seeded, store):
    plan = seeded.post(PLANS, json={"scanner_id": "example"}).json()
    assert plan["options"]["noise"] == 0.02
    assert store.jobs.get(plan["job_id"]).kind is kinds.PLAN
    calibration = seeded.get("/v1/calibrations/example").json()
    assert (calibration["verdict"], calibration["source_frame"]["source_distance_mm"]) == ("pass", 917.1)
    assert seeded.get("/v1/drifts/example").json()["result"]["within_tolerance"] is True
    assert seeded.get("/v1/plans/example").json()["result"]["predicted_ray_error_mm"]["rms"] == 0.02
    assert seeded.get("/v1/reconstructions/example").json()["result"]["shape"] == [3, 32, 32]


@pytest.mark.parametrize("kind", ["calibrations", "drifts"])
def test_they_are_listed_by_scanner_and_state(seeded, kind):
    seeded.post(f"/v1/{kind}", json={"scan_id": "example"})
    listed = {state: seeded.get(f"/v1/{kind}?state={state}").json()["items"] for state in ("queued", "succeeded")}
    assert [item["id"] for item in listed["succeeded"]] == ["example"]
    assert (listed["succeeded"][0]["links"]["self"], len(listed["queued"])) == (f"/v1/{kind}/example", 1)
    assert seeded.get(f"/v1/{kind}?scanner_id=example-spare").json()["items"] == []


def test_plans_are_listed_by_phantom_and_jobs_by_kind(seeded):
    assert [item["id"] for item in seeded.get("/v1/plans?phantom_id=l-shape").json()["items"]] == ["example"]
    assert seeded.get("/v1/plans?phantom_id=rectangle-with-hole").json()["items"] == []
    assert {job["kind"] for job in seeded.get("/v1/jobs?kind=drift").json()["items"]} == {"drift"}
