"""A phantom is the same in all its rows; where it ends, everything changes."""

import numpy as np

from sawmill_tomography.calibration.phantom_rows import segments
from sawmill_tomography.geometry.geometry import Scanner, Theta
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells

SCANNER = Scanner(859.46, 768, 1.502864583)
FRAME = Theta(1.2, 741.0, 212.0, 31.0, 0.17).source_frame(859.46)
ANGLES = (np.arange(30) + 0.5) * 2.0 * np.pi / 30


def stack_of(bodies, noise, seed):
    stack = np.stack([analytic.project(body, DetectorCells.of(SCANNER), FRAME, ANGLES) for body in bodies], axis=1)
    return stack + noise * np.random.default_rng(seed).standard_normal(stack.shape)


def test_phantom_and_log_are_distinguished():
    wood, log = L_SHAPE.of_density(SAPWOOD_PER_MM), LogModel.random(1300)
    bodies = [wood] * 4 + [log.slice_at(40.0 + 4.0 * row) for row in range(7)]
    assert min(segments(stack_of(bodies, 0.02, 1301)), key=lambda run: run.start) == slice(0, 4)


def test_a_phantom_in_every_row_is_one_run():
    assert segments(stack_of([L_SHAPE] * 6, 3.0, 1302)) == [slice(0, 6)]


def test_one_row_is_one_run():
    assert segments(stack_of([L_SHAPE], 1.0, 1303)) == [slice(0, 1)]
