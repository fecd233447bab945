"""The whole job over HTTP, on each of the two engines."""

import math
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image

from sawmill_contracts.calibrations import CalibrationSucceeded
from sawmill_tomography.geometry.geometry import angle_difference
from sawmill_tomography.geometry.ray_error import ray_error

pytestmark = pytest.mark.slow


def chunks(path: Path, size: int = 100_000):
    with path.open("rb") as stream:
        while chunk := stream.read(size):
            yield chunk


def opened(content: bytes) -> Image.Image:
    picture = Image.open(BytesIO(content))
    picture.load()
    assert picture.format == "PNG"
    return picture


def test_from_a_stack_of_counts_to_a_theta_and_a_log(engine, mill_scan, events, offline):
    scanner_id = engine.create_scanner(mill_scan.scanner)
    scan = engine.upload(
        chunks(mill_scan.path), scanner_id=scanner_id, data="counts", phantom_id="l-shape", phantom_rows="0:2"
    )
    asked = engine.post("/v1/calibrations", json={"scan_id": scan["id"], "activate": True})
    log = {"scan_id": scan["id"], "calibration_id": asked["id"], "rows": "2:4", "method": "fbp"}
    wanted = engine.post("/v1/reconstructions", json=log)

    reported = events(engine, asked["job_id"])
    fractions = [job["progress"]["fraction"] for job in reported if job["progress"]]
    assert reported[-1]["state"] == "succeeded"
    assert [job["waiting_for"] for job in reported if job["waiting_for"]] == []
    assert reported[-1]["attempt"] == 1
    assert fractions == sorted(fractions)
    assert engine.wait(wanted["job_id"])["state"] == "succeeded"

    read = engine.get(f"/v1/scans/{scan['id']}").json()
    assert (read["state"], read["format"]) == ("ready", "hdf5-nxtomo")
    assert read["shape"] == {"views": 180, "rows": 4, "detector": 512}

    check_calibration(engine, scanner_id, asked["id"], mill_scan)
    check_reconstruction(engine, wanted["id"], mill_scan)
    assert offline.asked_for() == ""


def check_calibration(service, scanner_id, calibration_id, mill_scan):
    path = f"/v1/calibrations/{calibration_id}"
    document = service.get(path).json()
    found = CalibrationSucceeded.model_validate(document)
    truth, frame = mill_scan.theta.source_frame(mill_scan.scanner.source_to_cor_mm), found.source_frame
    assert ray_error(mill_scan.scanner, truth, frame).rms_mm < 0.05
    assert abs(math.degrees(angle_difference(frame.psi_rad, truth.psi_rad))) < 0.1
    assert found.phantom_position_mm == pytest.approx((-4.0, 2.5), abs=0.1)
    assert (found.verdict, found.rows, found.views) == ("pass", (0, 2), 180)
    assert service.get(f"/v1/scanners/{scanner_id}").json()["active_calibration_id"] == calibration_id
    activated, made, *_ = service.get(f"/v1/scanners/{scanner_id}/history/entries").json()["items"]
    assert (activated["kind"], activated["subject_id"]) == ("activation", calibration_id)
    assert made["measured"]["cor_column_mm"] == found.source_frame.cor_column_mm

    assert min(opened(service.get(document["links"]["report"]).content).size) > 500
    assert min(opened(service.get(f"{path}/overlay.png").content).size) > 300
    with h5py.File(BytesIO(service.get(document["links"]["hdf5"]).content)) as file:
        shapes: dict[str, tuple[int, ...]] = {}
        file.visititems(
            lambda name, item: shapes.update({name: item.shape}) if isinstance(item, h5py.Dataset) else None
        )
    by_name = {name.rpartition("/")[2]: shape for name, shape in shapes.items()}
    assert by_name["sinogram"] == by_name["residual"] == (180, 512)


def check_reconstruction(service, reconstruction_id, mill_scan):
    path = f"/v1/reconstructions/{reconstruction_id}"
    document = service.get(path).json()
    whole = service.get(document["links"]["volume"]).content
    with h5py.File(BytesIO(whole)) as file:
        data = file["entry/reconstruction/data"]
        assert data.dtype == np.float32
        assert data.attrs["units"] == "1/mm"
        volume = data[()]
    assert list(volume.shape) == document["result"]["shape"] == [2, 256, 256]
    truth = mill_scan.log_image
    assert np.linalg.norm(volume[0] - truth) / np.linalg.norm(truth) < 0.16

    part = service.get(document["links"]["volume"], headers={"Range": "bytes=512-1535"})
    assert part.status_code == 206
    assert part.headers["content-range"] == f"bytes 512-1535/{len(whole)}"
    assert part.content == whole[512:1536]

    assert opened(service.get(document["links"]["first_slice"]).content).mode == "L"
    exact = opened(service.get(f"{path}/slices/1.png", params={"bits": 16}).content)
    low, high = (float(exact.text[name]) for name in ("window_low", "window_high"))
    assert exact.mode == "I;16"
    values = low + (high - low) * np.asarray(exact, np.float64) / 65535
    assert np.allclose(values, volume[1].clip(low, high), atol=(high - low) / 65535)
