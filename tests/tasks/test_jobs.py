"""Each kind of job on a real store, in this process."""

import io
from dataclasses import replace

import h5py
import numpy as np
import pytest
from PIL import Image

from worker.contracts.base import DataKind
from worker.contracts.calibrations import CalibrationResult
from worker.contracts.jobs import FailureKind, JobKind
from worker.contracts.phantoms import PhantomDrawing, PhantomPicture
from worker.contracts.reconstructions import ReconstructionAsk
from worker.contracts.scans import ScanSpec
from worker.tasks.conversion import from_theta, to_frame, to_phantom
from worker.tasks.failures import JobFailure
from worker.tasks.running import run
from worker.tomography.built_in import RECTANGLE_WITH_HOLE
from worker.tomography.ray_error import ray_error


@pytest.fixture
def upload(store, spec):
    """Accept a stack (views, rows, detector) of line integrals of one scanner's."""
    scanner = store.scanners.create(spec(), scanner_id="line-2")

    def accept(stack: np.ndarray, angles_deg: str):
        buffer = io.BytesIO()
        np.save(buffer, stack.astype(np.float32))
        received = store.files.receive([buffer.getvalue()], max_bytes=10**8)
        told = ScanSpec(
            scanner_id=scanner.id, data=DataKind.LINE_INTEGRALS, angles_deg=angles_deg, phantom_id="l-shape"
        )
        return store.scans.accept(told, received)

    return accept


@pytest.fixture
def ingested(upload, attempt, finish):
    """The same, read and ready."""

    def ready(stack: np.ndarray, angles_deg: str):
        scan = upload(stack, angles_deg)
        reading = attempt(JobKind.INGEST)
        finish(reading, run(reading))
        return scan

    return ready


def test_an_upload_becomes_the_one_form(upload, attempt):
    stack = np.random.default_rng(4).uniform(0, 1, (6, 2, 128))
    upload(stack, "10:60")
    reading = attempt(JobKind.INGEST)
    result = run(reading)
    assert result["shape"] == {"views": 6, "rows": 2, "detector": 128}
    assert result["angular_range_deg"] == pytest.approx([10.0, 310.0])
    with h5py.File(reading.output / "scan.h5") as file:
        detector = file["entry/instrument/detector"]
        assert np.array_equal(detector["data"][()], stack.astype(np.float32))
        assert detector["x_pixel_size"][()] == 9.0
        assert detector["data"].chunks[1] == 1


def test_another_detectors_upload_is_refused(upload, attempt):
    upload(np.ones((6, 1, 100)), "0:60")
    with pytest.raises(JobFailure, match=r"100 detector cells .* num_detector_pixels 128") as failure:
        run(attempt(JobKind.INGEST))
    assert (failure.value.kind, failure.value.code) == (FailureKind.INPUT, "wrong-shape")


def test_a_calibration_writes_its_pictures_and_numbers(store, ingested, attempt, ask, sinogram, turn, scanner, theta):
    scan = ingested(sinogram(turn(60))[:, None], "3:6")
    store.calibrations.accept(ask(scan_id=scan.id))
    told = []
    calibrating = attempt(JobKind.CALIBRATE, told)
    result = CalibrationResult.model_validate(run(calibrating))
    error = ray_error(scanner, theta.source_frame(859.46), to_frame(result.source_frame))
    assert error.rms_mm < 0.02
    assert result.comparison is None
    assert {path.name for path in calibrating.output.iterdir()} == {"report.png", "overlay.png", "result.h5"}
    fractions = [progress.fraction for progress in told]
    assert fractions == sorted(fractions)


def test_a_calibration_is_compared_with_the_active_one(store, ingested, attempt, finish, ask, sinogram, turn):
    scan = ingested(sinogram(turn(60))[:, None], "3:6")
    first = store.calibrations.accept(ask(scan_id=scan.id, activate=True))
    calibrating = attempt(JobKind.CALIBRATE)
    finish(calibrating, run(calibrating))
    assert store.scanners.get("line-2").active_calibration_id == first.id
    # The same sinogram with its angles counted backwards: a scanner that now turns the other way.
    other = ingested(sinogram(turn(60))[:, None], "-3:-6")
    store.calibrations.accept(ask(scan_id=other.id))
    result = run(attempt(JobKind.CALIBRATE))
    assert result["comparison"]["calibration_id"] == first.id
    assert not result["comparison"]["within_tolerance"]
    assert "turns the other way" in result["comparison"]["reason"]


def test_a_partial_turn_has_no_image_and_still_a_report(store, ingested, attempt, ask, sinogram, scanner, theta):
    angles = np.deg2rad(np.arange(0.0, 200.0, 4.0))
    scan = ingested(sinogram(angles)[:, None], "0:4")
    store.calibrations.accept(ask(scan_id=scan.id))
    calibrating = attempt(JobKind.CALIBRATE)
    result = CalibrationResult.model_validate(run(calibrating))
    error = ray_error(scanner, theta.source_frame(859.46), to_frame(result.source_frame))
    assert error.rms_mm < 0.05
    for name in ("report.png", "overlay.png"):
        with Image.open(calibrating.output / name) as picture:
            assert min(picture.size) > 300


def test_a_reconstruction_uses_the_theta_it_is_given(store, ingested, attempt, sinogram, turn, theta):
    scan = ingested(np.repeat(sinogram(turn(60))[:, None], 2, axis=1), "3:6")
    wanted = ReconstructionAsk(scan_id=scan.id, theta=from_theta(theta), rows="1:2", size=64, field_mm=420.0)
    store.reconstructions.accept(wanted)
    reconstructing = attempt(JobKind.RECONSTRUCT)
    result = run(reconstructing)
    assert (result["shape"], result["rows"]) == ([1, 64, 64], [1, 2])
    with h5py.File(reconstructing.output / "volume.h5") as file:
        image = file["entry/reconstruction/data"][0]
    inside, outside = image[45, 20], image[20, 20]  # x > 0 holds the L's long leg, x < 0 and y < 0 nothing
    assert inside == pytest.approx(1.0, abs=0.2)
    assert outside == pytest.approx(0.0, abs=0.2)


def test_a_picture_is_traced_to_its_drawing(store, attempt):
    drawn = Image.fromarray(np.rint(255 * RECTANGLE_WITH_HOLE.rasterise(800, 400.0)).astype(np.uint8))
    buffer = io.BytesIO()
    drawn.save(buffer, format="PNG")
    said = PhantomPicture(name="traced", width_mm=400.0, size_tolerance=0.002)
    store.phantoms.accept_picture(said, store.files.receive([buffer.getvalue()], max_bytes=10**7))
    drawing = PhantomDrawing.model_validate(run(attempt(JobKind.TRACE_PHANTOM)))
    assert (drawing.name, drawing.size_tolerance) == ("traced", 0.002)
    traced = replace(to_phantom(drawing), name=RECTANGLE_WITH_HOLE.name)
    difference = traced.rasterise(400, 400.0) - RECTANGLE_WITH_HOLE.rasterise(400, 400.0)
    assert np.abs(difference).mean() < 1e-3
