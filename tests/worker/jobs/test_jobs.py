"""Each kind of job on a real store, in this process."""

import io
import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
from PIL import Image
from scan_files import read_stored_scan

from sawmill_calibration import read_scan
from sawmill_calibration.known_geometry import to_phantom
from sawmill_calibration.pictures.calibration_report import overlay_png
from sawmill_calibration.scans.scan import as_scanner
from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.phantoms import PhantomDrawing, PhantomPicture
from sawmill_contracts.scans import ScanSpec
from sawmill_formats.output import calibration_file
from sawmill_formats.output.scan_writer import new_scan
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.jobs import FailureKind
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_vocabulary import DataKind, DetectorModule, ReconstructionMethod, Scanner
from sawmill_vocabulary.calibration_arrays import CalibrationArrays
from sawmill_worker.jobs.calibrate import declared_cells, known_cells
from sawmill_worker.jobs.running import run

pytestmark = pytest.mark.slow


def test_an_upload_becomes_the_one_form(upload, attempt):
    stack = np.random.default_rng(4).uniform(0, 1, (6, 2, 128))
    upload(stack, "10:60")
    reading = attempt(kinds.INGEST)
    result = run(reading)
    assert result["shape"] == {"views": 6, "rows": 2, "detector": 128}
    assert result["angular_range_deg"] == pytest.approx([10.0, 310.0])
    with h5py.File(reading.output / "scan.h5") as file:
        detector = file["entry/instrument/detector"]
        assert np.array_equal(detector["data"][()], stack.astype(np.float32))
        assert (detector["x_pixel_size"][()], detector["data"].chunks[1]) == (9.0, 1)


def test_another_detectors_upload_is_refused(upload, attempt):
    upload(np.ones((6, 1, 100)), "0:60")
    with pytest.raises(JobFailure, match=r"100 detector cells .* num_detector_pixels 128") as failure:
        run(attempt(kinds.INGEST))
    assert (failure.value.kind, failure.value.code) == (FailureKind.INPUT, "other-detector")


def test_a_calibration_writes_its_numbers_and_what_pictures_are_drawn_from(
    ingested, calibrating, sinogram, turn, scanner, theta
):
    reported = []
    job = calibrating(ingested(sinogram(turn(60))[:, None], "3:6"), reported)
    answer = run(job)
    result = CalibrationResult.model_validate(answer)
    assert ray_error(scanner, theta.source_frame(859.46), result.source_frame).rms_mm < 0.02
    assert result.comparison is None
    assert [path.name for path in job.output.iterdir()] == ["result.h5"]
    fractions = [progress.fraction for progress in reported]
    assert fractions == sorted(fractions)
    with h5py.File(job.output / "result.h5") as file:
        units = {name: data.attrs["units"] for name, data in file["entry/arrays"].items()}
    assert units["phantom_outlines_mm"] == units["phantom_field_mm"] == "mm"
    record = calibration_file.read_calibration(job.output / "result.h5")
    assert record.answer == json.loads(json.dumps(answer))
    made = record.arrays
    assert np.allclose(made["sinogram"] - made["model"], made["residual"], atol=1e-4)  # float32 of values up to 300
    assert np.array_equal(made["phantom_outlines_mm"][0], made["phantom_outlines_mm"][-1])
    evaluations, best = made["search_history"].T
    assert (np.diff(best) < 0.0).all()
    assert evaluations[-1] <= answer["search"]["evaluations"]
    assert_shows_the_l(made["phantom_image"], made["phantom_field_mm"])


def test_saturated_cells_are_the_first_reason(send, ingest, calibrating, sinogram, turn, scanner, theta):
    counts = 65_535.0 * np.exp(-sinogram(turn(60)) / 100.0)[:, None]
    arrays = {"projections": counts, "flats": np.full((10, 1, 128), 65_535.0), "angles_deg": np.rad2deg(turn(60))}
    job = calibrating(ingest(send(arrays, data=DataKind.COUNTS, phantom_id="l-shape")))
    result = CalibrationResult.model_validate(run(job))
    assert (result.verdict, result.coded_reasons[0].code) == ("watch", "cells-saturated")
    found = ray_error(scanner, theta.source_frame(859.46), result.source_frame)
    assert found.rms_mm < result.predicted_ray_error_mm.upper_95
    # The file that the service prepared has the share of the cells too.
    assert read_scan(job.file, data="line-integrals", source_to_cor_mm=859.46).saturated_share == 1.0


def test_a_partial_turn_has_an_image_by_total_variation_and_a_report(ingested, calibrating, sinogram, scanner, theta):
    job = calibrating(ingested(sinogram(np.deg2rad(np.arange(0.0, 200.0, 4.0)))[:, None], "0:4"))
    result = CalibrationResult.model_validate(run(job))
    assert ray_error(scanner, theta.source_frame(859.46), result.source_frame).rms_mm < 0.05
    record = calibration_file.read_calibration(job.output / "result.h5")
    arrays = CalibrationArrays.of(record.arrays)
    assert arrays.phantom_image_method is ReconstructionMethod.TOTAL_VARIATION
    assert_shows_the_l(arrays.phantom_image, arrays.phantom_field_mm)
    assert "log_after" not in record.arrays
    with Image.open(io.BytesIO(overlay_png(arrays))) as picture:
        assert min(picture.size) > 300


def assert_shows_the_l(image, field_mm, *, within=0.15):
    """x > 0 holds the L's long leg, x < 0 and y < 0 nothing."""
    middle = len(image) / 2
    leg, beside = (round(middle + mm * len(image) / field_mm) for mm in (60.0, -60.0))
    assert (image[leg, beside], image[beside, beside]) == pytest.approx((1.0, 0.0), abs=within)


def test_a_log_beside_the_phantom_is_kept_before_and_after(
    ingested, calibrating, finish, sinogram, turn, scanner, theta
):
    log = Phantom("log", (Disc((20.0, 10.0), 110.0), Disc((40.0, -30.0), 15.0)))
    shadow = project(log, DetectorCells.of(scanner), theta.source_frame(859.46), turn(60), rays_per_cell=8)
    stack = np.stack([sinogram(turn(60))] * 2 + [shadow] * 4 + [np.zeros_like(shadow)], axis=1)
    scan, kept = ingested(stack, "3:6"), []
    for _ in range(2):
        job = calibrating(scan, activate=True, rows="0:2")
        result = run(job)
        kept.append(calibration_file.read_calibration(job.output / "result.h5").arrays)
        finish(job, result)
    first, second = kept
    assert [one["log_before_with"] for one in kept] == [b"unshifted", b"active"]
    # Nothing shifted or tilted is not this scanner: the log is not where it is.
    assert np.corrcoef(first["log_before"].ravel(), first["log_after"].ravel())[0, 1] < 0.9
    assert first["log_row"] == 4
    assert np.array_equal(first["log_after"], second["log_before"])
    assert first["log_after"][128 + round(20 / 345 * 256), 128] == pytest.approx(1.0, abs=0.1)


def test_a_reconstruction_uses_the_theta_and_the_rows_that_it_is_given(ingested, reconstructing, sinogram, turn, theta):
    scan = ingested(sinogram(turn(60))[:, None] * np.arange(7.0)[:, None], "3:6")
    job = reconstructing(scan, theta=theta, rows="1:7:2", size=64, field_mm=420.0)
    result = run(job)
    assert (result["shape"], result["rows"], result["row_step"]) == ([3, 64, 64], [1, 7], 2)
    with h5py.File(job.output / "volume.h5") as file:
        images = file["entry/reconstruction/data"][()]
    assert_shows_the_l(images[0], 420.0, within=0.2)
    # Rows 1, 3 and 5 hold 1, 3 and 5 times the phantom; single precision.
    assert images.mean(axis=(1, 2)) / images[0].mean() == pytest.approx([1.0, 3.0, 5.0], rel=1e-3)


def test_a_reconstruction_takes_out_the_hardening_that_its_calibration_found(
    ingested, calibrating, reconstructing, finish, sinogram, turn
):
    """Of 13 % on the phantom's longest path."""
    lengths = sinogram(turn(60))
    spread = 0.3 / lengths.max()
    scan = ingested((np.log1p(spread * lengths) / spread)[:, None], "3:6")
    known = calibrating(scan)
    finish(known, run(known))
    for handling, sentences in (("auto", 1), ("none", 0)):
        job = reconstructing(scan, calibration_id=known.job.subject_id, hardening=handling, size=32)
        result = run(job)
        finish(job, result)
        assert sum(done.startswith("beam hardening of -") for done in result["preparation"]) == sentences


def test_a_picture_is_traced_to_its_drawing(store, attempt):
    drawn = Image.fromarray(np.rint(255 * RECTANGLE_WITH_HOLE.rasterise(800, 400.0)).astype(np.uint8))
    buffer = io.BytesIO()
    drawn.save(buffer, format="PNG")
    given = PhantomPicture(name="traced", width_mm=400.0, size_tolerance=0.002)
    store.phantoms.accept_picture(given, store.files.receive([buffer.getvalue()], max_bytes=10**7))
    drawing = PhantomDrawing.model_validate(run(attempt(kinds.TRACE_PHANTOM)))
    assert (drawing.name, drawing.size_tolerance) == ("traced", 0.002)
    traced = replace(to_phantom(drawing), name=RECTANGLE_WITH_HOLE.name)
    assert np.abs(traced.rasterise(400, 400.0) - RECTANGLE_WITH_HOLE.rasterise(400, 400.0)).mean() < 1e-3


@pytest.fixture
def sent(store, spec, attempt, tmp_path):
    """What is kept of a file that states modules and an arc."""
    store.scanners.create(spec(), scanner_id="line-2")
    about = {"angles_rad": np.deg2rad(60.0 * np.arange(6)), "detector_pitch_mm": 9.0, "row_pitch_mm": None}
    cells = {"detector_modules": (DetectorModule(64, 1.5, 0.01),), "detector_arc_radius_mm": 1500.0}
    with new_scan(tmp_path / "sent.nxs", (6, 1, 128), **about, **cells) as written:
        written.data[...] = 1.0
        written.note(air_level=None, provenance={})
    received = store.files.receive([(tmp_path / "sent.nxs").read_bytes()], max_bytes=10**7)
    store.scans.accept(ScanSpec(scanner_id="line-2", data=DataKind.LINE_INTEGRALS), received)
    reading = attempt(kinds.INGEST)
    run(reading)
    return read_stored_scan(reading.output / "scan.h5")


def test_cells_that_a_file_states_stay_with_its_scan_and_a_scanners_declared_ones_come_first(sent):
    constants = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=128, detector_pitch_mm=9.0)
    used = declared_cells(constants, sent)
    (kept,) = used.detector_modules
    assert (kept.first_cell, kept.gap_mm, kept.kink_rad) == pytest.approx((64, 1.5, 0.01))
    assert used.detector_arc_radius_mm == 1500.0
    declared = replace(constants, detector_modules=(DetectorModule(64, 0.3),), detector_arc_radius_mm=1574.0)
    assert declared_cells(declared, sent) == declared


def test_a_calibration_starts_from_the_cells_of_the_detector_that_is_there(sent):
    found = (DetectorModule(900, 0.5),)
    wide = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=1536, detector_pitch_mm=0.75)
    calibrated, exchanged = replace(wide, detector_modules=found), replace(wide, num_detector_pixels=768)
    calibrated = replace(calibrated, detector_arc_radius_mm=1574.0, detector_waves_mm=(0.2, -0.1))
    assert known_cells(wide, sent, None).detector_arc_radius_mm == 1500.0
    assert known_cells(wide, sent, calibrated) == calibrated
    assert as_scanner(calibrated) == Scanner(859.46, 1536, 0.75, found, 1574.0, (0.2, -0.1))
    assert known_cells(exchanged, sent, calibrated).detector_modules == sent.detector_modules, "768 cells have no 900"
