"""A data folder of version 0.1.0 is served and worked on by this version."""

import io
import math
import tarfile

import h5py
import numpy as np
import pytest
from emptied_databases import ARCHIVE

from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store

pytestmark = pytest.mark.slow


@pytest.fixture
def store(tmp_path):
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(tmp_path / "data", filter="data")
    opened = Store.open(StorageSettings(data_folder=tmp_path / "data", database_url=None))
    yield opened
    opened.close()


def get(client, path):
    answer = client.get(path)
    assert answer.status_code == 200, answer.text
    return answer


def test_a_data_folder_of_0_1_0_is_answered_served_filled_from_and_worked_on(client, store, worker):
    scanner = get(client, "/v1/scanners/example").json()
    assert (scanner["name"], scanner["active_calibration_id"]) == ("example scanner", "example")
    calibrations = {each["id"]: each["state"] for each in get(client, "/v1/calibrations").json()["items"]}
    assert calibrations == {"example": "succeeded", "second": "succeeded", "failed": "failed", "cancelled": "cancelled"}
    calibration = get(client, "/v1/calibrations/example").json()
    assert (calibration["verdict"], calibration["rays_verdict"], calibration["views"]) == ("pass", None, 120)
    # The geometry of that version's examples.
    assert calibration["theta"]["detector_to_cor_mm"] == pytest.approx(741.0, abs=1.0)
    assert calibration["theta"]["detector_tilt"] == pytest.approx(0.17, abs=0.002)
    drift = get(client, "/v1/drifts/example").json()
    assert (drift["calibration_id"], drift["result"]["within_tolerance"]) == ("example", True)
    assert get(client, "/v1/plans/example").json()["result"]["scale_ray_error_mm"] > 0.0
    assert "example-spare" in {each["id"] for each in get(client, "/v1/phantoms").json()["items"]}
    assert {each["enabled"] for each in get(client, "/v1/schedules").json()["items"]} == {False}
    for page in ("/", "/scanners/example", "/calibrations/example/report", "/logs/example", "/scans/example", "/jobs"):
        get(client, page)
    calibration = get(client, "/v1/calibrations/example").json()
    with h5py.File(io.BytesIO(get(client, "/v1/calibrations/example/result.h5").content)) as file:
        assert file["entry/arrays/sinogram"].shape == (120, 192)
    assert get(client, calibration["links"]["report"]).content.startswith(b"\x89PNG")
    slices = np.load(io.BytesIO(get(client, "/v1/reconstructions/example/slices/0.npy").content))
    assert slices.shape == (256, 256)
    assert slices.max() > 0.0
    assert get(client, "/v1/reconstructions/example/slices/0.png").content.startswith(b"\x89PNG")
    assert get(client, "/v1/scans/example/sinogram.png").content.startswith(b"\x89PNG")
    measurements = get(client, "/v1/scanners/example/measurements").json()["items"]
    measured = {(each["kind"], each["subject_id"]): each for each in measurements}
    assert measured.keys() == {("calibration", "example"), ("drift", "example"), ("calibration", "second")}
    assert measured["drift", "example"]["against_id"] == measured["calibration", "second"]["against_id"] == "example"
    assert all(each["cor_column_standard_deviation_mm"] > 0.0 for each in measurements)
    second = get(client, "/v1/calibrations/second").json()
    check = get(client, "/v1/drifts/example").json()["result"]
    changes = second["comparison"]["tilt_change_deg"], math.degrees(check["change"]["tilt_rad"])
    tilts = [math.degrees(tilt_rad) for tilt_rad in (second["source_frame"]["tilt_rad"], check["measured"]["tilt_rad"])]
    rows = measured["calibration", "second"], measured["drift", "example"]
    assert [each["tilt_change_deg"] for each in rows] == pytest.approx(changes)
    assert [each["tilt_deg"] for each in rows] == pytest.approx(tilts)
    history = get(client, "/v1/scanners/example/history/entries").json()["items"]
    assert [f"{each['type']} {each['subject_id']}" for each in history] == [
        *("cancelled cancelled", "calibration-rolled-back example", "failed failed", "calibration-activated second"),
        *("succeeded second", "succeeded example", "calibration-activated example", "succeeded example"),
    ]
    assert history[1]["why"] == "back to the first"
    asked = client.post("/v1/calibrations", json={"scan_id": "example"})
    assert asked.status_code == 202, asked.text
    assert [store.jobs.get(store.plans.get("queued").job_id).state, asked.json()["state"]] == ["queued", "queued"]
    worker.finish_plan()
    worker.finish_calibration()
    assert get(client, "/v1/plans/queued").json()["state"] == "succeeded"
    assert get(client, f"/v1/calibrations/{asked.json()['id']}").json()["state"] == "succeeded"
