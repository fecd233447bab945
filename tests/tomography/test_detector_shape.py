"""Detectors on an arc: the places of their cells, the phantom's shadow, images and drift checks."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.support.exact_chords import FRAME, BentDetector, Detector, full_turn, scan

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_tomography.geometry.detector_shape import cell_points, flat_borders_mm
from sawmill_tomography.geometry.geometry import FanBeamGeometry, cell_borders_mm
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.physics.simulate import simulate_physics
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.reconstruction.tikhonov import tikhonov
from sawmill_vocabulary import DetectorModule, GeometryError, Rotation, Scanner, SourceFrame

CELLS, PITCH_MM, R_S = 768, 1.5, 859.46
WOOD = [replace(shape, density=0.008) for shape in L_SHAPE.shapes]
ON_ARC = BentDetector(CELLS, PITCH_MM, radius_mm=1574.0)
CENTRED = SourceFrame(0.3, 900.0, 1574.0, 0.0, 0.0)


def scanner(arc=None, modules=()):
    return Scanner(R_S, CELLS, PITCH_MM, modules, arc)


def test_an_arc_around_the_source_has_its_cells_at_equal_angles():
    angles = cell_borders_mm(scanner()) / 1574.0
    borders = flat_borders_mm(scanner(1574.0), CENTRED)
    # A border between two cells is where the tangents of both meet, to the third power of half a cell.
    for side, expected in ((0, angles[:-1]), (1, angles[1:])):
        np.testing.assert_allclose(borders[:, side], 1574.0 * np.tan(expected), atol=1e-6)


def test_the_places_on_any_arc_follow_the_closed_formula():
    """docs/look-up/conventions.md#arcs, for the cells' middles: f the source's distance, u_p its foot on the line."""
    f = FRAME.source_to_detector_mm * math.cos(FRAME.tilt_rad)
    foot = FRAME.cor_column_mm - FRAME.source_to_detector_mm * math.sin(FRAME.tilt_rad)
    at = (np.arange(CELLS) + 0.5 - 0.5 * CELLS) * PITCH_MM
    for rho in (700.0, 1574.0, 1e5):
        x, depth = rho * np.sin(at / rho), rho * (1.0 - np.cos(at / rho))
        expected = foot + (x - foot) * f / (f - depth)
        across, along = cell_points(scanner(rho), FRAME).T
        c, s = math.cos(FRAME.tilt_rad), math.sin(FRAME.tilt_rad)
        found = FRAME.cor_column_mm + FRAME.source_to_detector_mm * across / (along * c - across * s)
        np.testing.assert_allclose(found, expected, atol=1e-9)
        assert np.abs(flat_borders_mm(scanner(rho), FRAME).mean(axis=1) - expected).max() < 1e-3


def test_modules_on_an_arc_begin_where_the_arc_is():
    whole = cell_points(scanner(1574.0), FRAME)
    turned = cell_points(scanner(1574.0, (DetectorModule(200), DetectorModule(600, 0.0, 0.01))), FRAME)
    np.testing.assert_allclose(turned[:600], whole[:600], atol=1e-9)
    assert np.hypot(*(turned[600] - whole[600])) == pytest.approx(0.01 * 0.5 * PITCH_MM, rel=1e-2)


@pytest.fixture(scope="module")
def turn():
    angles = full_turn(90)
    return angles, -np.log(scan(WOOD, ON_ARC, FRAME, angles))


def test_the_forward_model_and_the_simulator_see_the_shadow_on_an_arc(turn):
    angles, lines = turn
    wood = replace(L_SHAPE, shapes=tuple(WOOD))
    model = analytic.project(wood, DetectorCells.of(scanner(1574.0)), FRAME, angles)
    # Beside the edges, where the mean of the line integrals is not that of the intensities.
    assert np.median(np.abs(model - lines)[lines > 0.1]) < 1e-4
    flat = analytic.project(wood, DetectorCells.of(scanner()), FRAME, angles)
    assert np.sqrt(np.mean((flat - lines) ** 2)) > 20.0 * np.sqrt(np.mean((model - lines) ** 2))
    exact = scan(WOOD, ON_ARC, FRAME, angles[:3])
    np.testing.assert_allclose(
        simulate_physics(wood, scanner(1574.0), FRAME, angles[:3], seed=1).signal, exact, atol=1e-3
    )


def test_images_on_an_arc_are_as_good_as_on_a_line(turn):
    angles, lines = turn
    grid = ImageGrid(96, 400.0)
    flat = -np.log(scan(WOOD, Detector(CELLS, PITCH_MM), FRAME, angles))
    on_arc, on_line = (
        Projector(FanBeamGeometry(one, FRAME.theta(R_S), angles), grid) for one in (scanner(1574.0), scanner())
    )
    for method in (fbp, tikhonov):
        expected = method(on_line, flat).image
        assert np.linalg.norm(method(on_arc, lines).image - expected) < 0.02 * np.linalg.norm(expected)
        assert np.linalg.norm(method(on_line, lines).image - expected) > 0.1 * np.linalg.norm(expected)


def test_a_declared_arc_is_calibrated_and_a_drift_check_knows_it(turn):
    angles, lines = turn
    noisy = lines + 0.01 * np.random.default_rng(5).standard_normal(lines.shape)
    found = calibrate(CalibrationTask(scanner(1574.0), L_SHAPE, noisy, angles))
    assert found.scanner.detector_arc_radius_mm == 1574.0
    error = ray_error(scanner(1574.0), FRAME, found.frame, radius_mm=found.radius_mm)
    assert error.rms_mm < found.findings.error_bars.predicted_ray_error.upper_95_mm < 0.1
    start = replace(FRAME, cor_column_mm=FRAME.cor_column_mm + 1.0)
    fit = detector_fit(scanner(1574.0), lines, angles, start, Rotation.AS_GIVEN)
    assert fit.cor_column_mm == pytest.approx(FRAME.cor_column_mm, abs=0.05)


def test_an_arc_of_more_than_half_a_circle_is_refused():
    with pytest.raises(GeometryError, match="detector_arc_radius_mm must be larger than 366"):
        scanner(360.0)
