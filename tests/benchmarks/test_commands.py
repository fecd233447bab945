"""Every study and every tool starts: modules are imported and arguments are parsed, all in one process."""

import subprocess
import sys
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from guard import error_mm, red
from published_pipeline import BACKGROUND, pixel_scan
from scanners import SCANNER
from scans import TRUE_FRAME, simulated

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import TAU, to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE

ROOT = Path(__file__).parents[2]
# Prints one line for each script that cannot be imported or does not describe its arguments.
PROGRAM = """
import contextlib, importlib, io, pathlib, sys

sys.path.insert(0, ".")
for path in sorted(pathlib.Path().glob("*.py")):
    described = io.StringIO()
    try:
        module = importlib.import_module(path.stem)
        if "ArgumentParser" in path.read_text():
            sys.argv = [path.name, "--help"]
            with contextlib.redirect_stdout(described):
                module.main()
            print(path.name, "goes on after --help")
    except SystemExit as ended:
        if ended.code or "usage:" not in described.getvalue():
            print(path.name, "ends with", ended.code)
    except Exception as error:
        print(path.name, repr(error))
"""


def test_every_script_is_imported_and_parses_its_arguments():
    command = [sys.executable, "-c", PROGRAM, ROOT / "benchmarks", ROOT / "docs/tools"]
    done = subprocess.run(command, cwd=ROOT / "benchmarks", capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


def erring(*errors_mm):
    """Measurements of equal seconds, whose errors follow each other again and again."""
    errors = cycle(errors_mm)
    return lambda: {"processor": 1.0, "clock": 1.0, "error_mm": next(errors)}


def lasting(*clock_s, processor_s=1.0):
    """Measurements one after another; the last one again and again."""
    left = list(clock_s)
    return lambda: {"processor": processor_s, "clock": left.pop(0) if len(left) > 1 else left[0]}


SCATTERED_MM = 0.010, 0.014, 0.018, 0.022, 0.026


@pytest.mark.parametrize(
    ("before", "now", "is_red"),
    [
        (lasting(1.0), lasting(1.2), False),
        (lasting(1.0), lasting(1.3), True),
        (lasting(1.0), lasting(2.0, 2.0, 2.0, 2.0, 1.2), False),  # one quiet measurement of five is enough
        (lasting(1.0), lasting(*[1.3] * 5, 1.2), False),  # slower once
        (lasting(1.0), lasting(1.0, processor_s=1.3), True),  # the other core does what the clock does not show
        (erring(0.010), erring(0.012), False),
        (erring(0.010), erring(0.013), True),
        (erring(*SCATTERED_MM), erring(0.021), False),  # within the noise of the seeds
        (erring(*SCATTERED_MM), erring(0.024), True),
        (erring(0.010), erring(0.010, 0.010, 0.010, 1.0, 1.0), False),  # two seeds of five
        (erring(0.010), erring(*[0.013] * 5, *[0.010] * 5), False),  # less exact once
    ],
)
def test_a_row_is_red_that_is_a_quarter_slower_or_less_exact_twice_in_a_row(before, now, is_red):
    rows = {"a row": now, "another row": lasting(1.0)}
    assert red(rows, {"a row": before, "another row": lasting(1.0)}) == (["a row"] if is_red else [])


def test_the_error_counts_scale_and_modules_and_no_rotation():
    """R that is longer by 0.1 % moves the rays by 0.1 % of their mean distance from the COR, 87 mm."""
    longer = replace(TRUE_FRAME, source_distance_mm=1.001 * TRUE_FRAME.source_distance_mm)
    turned = replace(TRUE_FRAME, psi_rad=TRUE_FRAME.psi_rad + 0.1)
    joint = {"first_cell": SCANNER.num_detector_pixels // 2, "gap_mm": 1.0, "kink_rad": 0.0}
    errors = [
        error_mm(to_vector(frame.theta(SCANNER.source_to_cor_mm)).tolist(), modules)
        for frame, modules in ((longer, []), (turned, []), (TRUE_FRAME, [joint]))
    ]
    assert errors[0] == pytest.approx(0.087, rel=0.01)
    assert errors[1] < 1e-9
    assert errors[2] > 0.1


def test_the_scan_that_stands_in_for_the_published_one_is_of_its_scanner_and_in_pixels():
    """The steps of its pixels make an RMS difference from exact rays of 0.034 mm, of a signal of 100 mm."""
    exact = simulated(L_SHAPE, noise=0.0, seed=0, angles=(np.arange(10) + 0.5) * TAU / 10) + BACKGROUND
    assert 0.01 < np.sqrt(np.mean((pixel_scan(10) - exact) ** 2)) < 0.1


@pytest.mark.parametrize("views", [90, 20])
def test_steps_of_pixels_without_noise_are_no_effects(views):
    """Slips, wobbles, an encoder and gains of views were fitted to the steps, in thirty times the seconds."""
    angles = (np.arange(views) + 0.5) * TAU / views
    found = calibrate(CalibrationTask(SCANNER, L_SHAPE, pixel_scan(views), angles), seed=1)
    assert (found.adjustments, found.judgement.verdict) == ((), "pass")
    error = ray_error(SCANNER, TRUE_FRAME, found.frame, radius_mm=found.radius_mm).rms_mm
    assert error < found.findings.error_bars.predicted_ray_error.upper_95_mm
