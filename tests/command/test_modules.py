"""A detector of modules from a scan of the phantom to the image of a log, by commands."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
from tests.support.exact_chords import Detector, counted, scan

from sawmill_formats.output.scan_writer import new_scan
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_vocabulary import DetectorModule, SourceFrame

FRAME = SourceFrame(0.3, 917.1, 1619.3, -109.1, -0.083)
MODULES = (DetectorModule(128, 4.0),)
GIVEN = ("--data", "line-integrals", "--angles-deg", "0:8")
VIEWS = 45


@pytest.fixture(scope="module")
def calibrated(run, tmp_path_factory):
    """The scan, in three rows of counts, and the answer of its calibration."""
    folder = tmp_path_factory.mktemp("modules")
    wood = [replace(shape, density=0.008) for shape in L_SHAPE.shapes]
    shown = scan(wood, Detector(256, 4.5, MODULES), FRAME, np.deg2rad(8.0 * np.arange(VIEWS)))
    stack = np.stack([counted(shown, seed=row) for row in range(3)], axis=1).astype(np.float32)
    np.save(folder / "scan.npy", stack)
    pitch = ("--source-to-cor-mm", 859.46, "--detector-pitch-mm", 4.5)
    answer = run("calibrate", folder / "scan.npy", *GIVEN, *pitch, "--phantom", "l-shape", "--json").stdout
    (folder / "answer.json").write_text(answer, encoding="utf-8")
    return folder, json.loads(answer)


def test_the_answer_says_where_the_modules_meet(calibrated):
    _, answer = calibrated
    (module,) = answer["scanner"]["detector_modules"]
    assert module["first_cell"] == 128
    # Three rows of 45 views determine the gap to 0.04 mm.
    assert module["gap_mm"] == pytest.approx(4.0, abs=0.15)
    assert answer["rays_verdict"] in {"pass", "watch"}, "cells of 4.5 mm leave a bound near the tolerance"
    assert any("modules meet at cell 128" in sentence for sentence in answer["adjustments"])


def test_a_volume_is_made_along_the_modules_and_says_so(calibrated, run, tmp_path):
    folder, answer = calibrated
    flags = ("--calibration", folder / "answer.json", "--size", 64, "--method", "fbp", "-o", tmp_path / "volume.h5")
    run("reconstruct", folder / "scan.npy", *GIVEN, *flags)
    with h5py.File(tmp_path / "volume.h5") as file:
        stated = json.loads(file["entry/geometry/detector_modules"][()])
    assert stated == answer["scanner"]["detector_modules"]


def test_no_toolkit_is_told_of_a_straight_detector(calibrated, run, tmp_path):
    folder, _ = calibrated
    flags = ("--calibration", folder / "answer.json", "--angles-deg", "0:8", "--views", VIEWS)
    refused = run("export", "--to", "astra", *flags, "-o", tmp_path / "vectors.txt", code=1)
    assert "only the form vectors holds modules and arcs" in refused.stderr
    assert not (tmp_path / "vectors.txt").exists()


def test_modules_that_the_file_states_are_known_from_the_start(calibrated, run, tmp_path):
    folder, answer = calibrated
    stack, path = np.load(folder / "scan.npy"), tmp_path / "scan.nxs"
    about = {"angles_rad": np.deg2rad(8.0 * np.arange(VIEWS)), "detector_pitch_mm": 4.5, "row_pitch_mm": None}
    with new_scan(path, stack.shape, **about, detector_modules=MODULES) as written:
        written.data[...] = stack
        written.note(air_level=None, provenance={})
    assert "2, which meet at cell 128" in run("inspect", path, "--data", "line-integrals").stdout
    flags = ("--data", "line-integrals", "--source-to-cor-mm", 859.46, "--phantom", "l-shape")
    known = json.loads(run("calibrate", path, *flags, "--json").stdout)
    assert not any("modules" in sentence for sentence in known["adjustments"])
    (module,) = known["scanner"]["detector_modules"]
    assert module["gap_mm"] == pytest.approx(4.0, abs=0.15)
    assert known["predicted_ray_error_mm"]["upper_95"] <= answer["predicted_ray_error_mm"]["upper_95"]
