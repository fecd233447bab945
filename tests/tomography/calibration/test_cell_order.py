"""Scans whose cells are not in their order: never a pass, and the cells are named."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.support.exact_chords import Detector, scan

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_vocabulary import Scanner, Theta

pytestmark = pytest.mark.slow

CELLS, PITCH_MM = 384, 3.005729166
# The phantom's shadow wanders over the cells 11 to 229.
FRAME = Theta(2.55, 714.7, 319.9, 43.7, math.radians(15.7)).source_frame(859.46)
ANGLES = np.deg2rad(0.5 + 15.0 * np.arange(24))
IN_ORDER = np.arange(CELLS)


def mirrored(first, after):
    """The order of the cells where a module is read backwards."""
    return np.concatenate([IN_ORDER[:first], IN_ORDER[first:after][::-1], IN_ORDER[after:]])


def exchanged(first, cells):
    """The order of the cells where two neighbouring modules are exchanged."""
    middle, after = first + cells, first + 2 * cells
    return np.concatenate([IN_ORDER[:first], IN_ORDER[middle:after], IN_ORDER[first:middle], IN_ORDER[after:]])


@pytest.fixture(scope="module")
def task():
    shapes = L_SHAPE.moved(8.0, -5.0).of_density(0.004).shapes
    lines = -np.log(scan(shapes, Detector(CELLS, PITCH_MM), FRAME, ANGLES))
    noise = 0.004 * np.random.default_rng(1).standard_normal(lines.shape)
    return CalibrationTask(Scanner(859.46, CELLS, PITCH_MM), L_SHAPE, lines + noise, ANGLES)


@pytest.mark.parametrize(
    ("order", "cells"),
    [
        # The shadow of the first 38 cells is on cells that the fit holds for air.
        pytest.param(np.roll(IN_ORDER, CELLS // 2), range(38), id="halves exchanged"),
        pytest.param(
            np.roll(IN_ORDER, -36), range(CELLS - 36, CELLS), id="readout from cell 36", marks=pytest.mark.nightly
        ),
        pytest.param(mirrored(32, 64), range(32, 64), id="module mirrored", marks=pytest.mark.nightly),
        pytest.param(exchanged(180, 12), range(180, 204), id="neighbours exchanged"),
    ],
)
def test_cells_out_of_order_fail_and_are_named(task, order, cells):
    found = calibrate(replace(task, sinogram=task.sinogram[:, order]), seed=1)
    assert found.judgement.verdict == "fail"
    reason = found.judgement.reasons[0]
    assert reason.codes == ("residual-in-all-views",)
    assert {reason.values["first_cell"], reason.values["last_cell"]} <= set(cells)
    assert len(cells) / 2 <= reason.values["last_cell"] - reason.values["first_cell"] + 1


def test_cells_in_order_pass(task):
    assert calibrate(task, seed=1).judgement.verdict == "pass"
