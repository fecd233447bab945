import numpy as np
import pytest

from sawmill_calibration.calibration.calibrate import CalibrationInput
from sawmill_calibration.calibration.calibration_files import find_log_row
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon
from sawmill_tomography.projection.analytic import DetectorCells, project


@pytest.fixture
def given(constants, sinogram, turn):
    """The phantom in rows 3 to 5 of a scan."""
    drawing = None  # no row is judged by it
    return CalibrationInput(sinogram(turn(24)), turn(24), (3, 6), constants, None, drawing, "")


@pytest.fixture
def shadow(scanner, theta, turn):
    """Of any body in the same scanner."""
    return lambda *shapes: project(
        Phantom("body", shapes), DetectorCells.of(scanner), theta.source_frame(859.46), turn(24), rays_per_cell=8
    )


def test_a_log_is_looked_for_amid_the_longer_run_beside_the_phantom(given, shadow):
    log = shadow(Disc((5.0, -3.0), 120.0))
    found = find_log_row(given, (0, 12), lambda _: log)
    assert found is not None
    assert found.row == 9
    assert find_log_row(given, (0, 7), lambda _: log).row == 1


@pytest.mark.parametrize("rows", [(3, 6), (4, 5)])
def test_without_rows_beside_the_phantom_nothing_is_read(given, rows):
    assert find_log_row(given, rows, lambda _: pytest.fail("a row was read")) is None


def test_air_and_more_of_the_phantom_are_no_log(given):
    rng = np.random.default_rng(11)
    noise = rng.normal(size=given.sinogram.shape) * 0.02 * given.sinogram.std()
    assert find_log_row(given, (0, 12), lambda _: noise) is None
    # The same phantom, thicker by a tenth and 2 % of noise on it.
    assert find_log_row(given, (0, 12), lambda _: 1.1 * given.sinogram + noise) is None


def test_a_log_as_large_as_the_phantom_is_one(given, shadow):
    square = [(-130.0, -130.0), (130.0, -130.0), (130.0, 130.0), (-130.0, 130.0)]
    for shape in (Disc((0.0, 0.0), 150.0), Polygon(tuple(square))):
        row = shadow(shape)
        assert find_log_row(given, (0, 12), lambda _, row=row: row) is not None
