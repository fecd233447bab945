"""Scans whose cells are not in their order, or not on a line: never a pass, and the cells are named."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.support.exact_chords import Detector, scan

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_vocabulary import Scanner, SourceFrame, Theta

pytestmark = pytest.mark.slow

CELLS, PITCH_MM = 384, 3.005729166
# The phantom's shadow wanders over the cells 11 to 229.
FRAME = Theta(2.55, 714.7, 319.9, 43.7, math.radians(15.7)).source_frame(859.46)
ANGLES = np.deg2rad(0.5 + 15.0 * np.arange(24))
IN_ORDER = np.arange(CELLS)
ON_ARC = SourceFrame(0.4, 1700.0, 2300.0, 20.0, 0.0)


class Arc(Detector):
    """Cells at equal angles about the source."""

    def points(self, frame, rays):
        along = (np.arange(self.cells * rays) + 0.5) * self.pitch_mm / rays - 0.5 * self.cells * self.pitch_mm
        angle = (along - frame.cor_column_mm) / frame.source_to_detector_mm
        ends = frame.source_to_detector_mm * np.stack([np.sin(angle), np.cos(angle)], -1)
        return ends.reshape(self.cells, rays, 2)


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


@pytest.mark.parametrize("views", [45, pytest.param(180, marks=pytest.mark.nightly)])
@pytest.mark.parametrize(("detector", "on_arc"), [(Arc, True), (Detector, False)])
def test_cells_on_an_arc_are_named_and_no_turntable(views, detector, on_arc):
    angles = (np.arange(views) + 0.5) * math.tau / views
    shapes = L_SHAPE.moved(6.0, -4.0).of_density(0.004).shapes
    lines = -np.log(scan(shapes, detector(640, 1.05), ON_ARC, angles))
    noise = 0.005 * np.random.default_rng(5).standard_normal(lines.shape)
    found = calibrate(CalibrationTask(Scanner(1700.0, 640, 1.05), L_SHAPE, lines + noise, angles), seed=1)
    assert found.judgement.verdict == ("watch" if on_arc else "pass")
    codes = [code for each in (*found.judgement.reasons, *found.adjustments) for code in each.codes]
    assert ("cells-on-arc" in codes) == on_arc
    assert not {"wobble", "encoder-once-and-twice"} & set(codes)


def test_cells_in_order_pass(task):
    assert calibrate(task, seed=1).judgement.verdict == "pass"
