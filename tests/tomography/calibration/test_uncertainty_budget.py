"""The lines of the uncertainty budget: what they add up to, and what scans with one disturbance alone show."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.calibration.uncertainty_budget import uncertainty_budget
from sawmill_tomography.geometry.geometry import Scanner, SourceFrame, to_vector
from sawmill_tomography.geometry.ray_error import predicted_ray_error, ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import Adjustment, Disc, Handedness, Rotation
from sawmill_vocabulary.uncertainty import UncertaintySource as Source

R_S, NOISE_MM = 859.46, 2.0
SCANNER, FRAME = Scanner(R_S, 256, 4.5), SourceFrame(0.3, 880.0, 1600.0, -30.0, -0.08)
KNOT = Disc((60.0, -100.0), 14.0, 0.8)
KNOWN = {"handedness": Handedness.AS_DRAWN, "rotation": Rotation.AS_GIVEN}


@pytest.fixture
def calibrated(full_turn):
    """Calibrate a scan with noise of its own, of the drawing or of another phantom, which may slip."""

    def found(seed=2201, *, seen=L_SHAPE, slip_mm=0.0, scanner=SCANNER, views=40, **options):
        angles = full_turn(views)
        positions = np.zeros((views, 2))
        positions[views // 2 :, 0] = slip_mm
        clean = analytic.project(seen, DetectorCells.of(SCANNER), FRAME, angles, position_mm=positions)
        noise = NOISE_MM * np.random.default_rng(seed).standard_normal(clean.shape)
        return calibrate(CalibrationTask(scanner, L_SHAPE, clean + noise, angles, **KNOWN, **options))

    return found


def lines_of(found):
    return {line.source: line for line in uncertainty_budget(found)}


CASES = [
    pytest.param({}, {Source.NOISE}, id="noise"),
    pytest.param({"scanner": replace(SCANNER, source_to_cor_mm=882.0)}, {Source.HELD}, id="R held"),
    pytest.param({"seen": replace(L_SHAPE, shapes=(*L_SHAPE.shapes, KNOT))}, {Source.BETWEEN_VIEWS}, id="a knot"),
    pytest.param(
        {"slip_mm": 2.0, "without": frozenset({Adjustment.SLIP})}, {Source.DECLINED}, id="a slip that is switched off"
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("scan", "sources"), CASES)
def test_the_lines_add_up_to_the_covariance(calibrated, scan, sources):
    found = calibrated(**scan)
    lines, evidence = lines_of(found), found.findings
    summed = [line for line in lines.values() if line.counted_in == "sum"]
    assert {line.source for line in summed} >= {Source.NOISE, Source.SIZE, *sources}
    predicted, scale = evidence.error_bars.predicted_ray_error, evidence.scale
    assert math.hypot(*(line.rays_mm for line in summed)) == pytest.approx(predicted.rms_mm, rel=1e-6)
    stated = 100.0 * math.hypot(scale.size, scale.statistical)
    assert math.hypot(*(line.scale_percent for line in summed)) == pytest.approx(stated, rel=1e-6)
    for name in ("rays_share_percent", "scale_share_percent"):
        assert sum(getattr(line, name) for line in summed) == pytest.approx(100.0)
    assert lines[Source.NOISE].standard_uncertainty == pytest.approx(NOISE_MM, rel=0.15)
    assert all(line.rays_share_percent is None for line in lines.values() if line.counted_in != "sum")


@pytest.mark.slow
def test_what_no_other_number_has_does_what_its_line_says(calibrated):
    """Wider cells and another r_S leave the rays; 1 % of moisture changes the scale alone, by what its line says."""
    found = calibrated()
    lines, R = lines_of(found), found.frame.source_distance_mm
    wider = calibrated(scanner=replace(SCANNER, detector_pitch_mm=4.5 * 1.001)).frame
    farther = calibrated(scanner=replace(SCANNER, source_to_cor_mm=R_S + 1.0)).frame
    assert [wider.source_distance_mm, wider.tilt_rad] == pytest.approx([R, found.frame.tilt_rad], rel=1e-6)
    assert wider.source_to_detector_mm == pytest.approx(1.001 * found.frame.source_to_detector_mm, rel=1e-6)
    np.testing.assert_allclose(to_vector(farther), to_vector(found.frame), rtol=1e-9)
    assert lines[Source.PITCH].rays_mm == lines[Source.SOURCE_DISTANCE].rays_mm == 0.0
    swollen = ray_error(SCANNER, found.frame, calibrated(seen=L_SHAPE.scaled(1.0025)).frame)
    assert lines[Source.MOISTURE].scale_percent == pytest.approx(100.0 * abs(swollen.scale_change), abs=0.01)
    assert (swollen.rms_mm, lines[Source.MOISTURE].rays_mm) == (pytest.approx(0.0, abs=0.005), 0.0)


@pytest.mark.slow
def test_where_r_is_held_the_stated_source_distance_moves_the_rays_as_its_line_says(calibrated):
    held, farther = (calibrated(scanner=replace(SCANNER, source_to_cor_mm=r_s)) for r_s in (882.0, 883.0))
    line = lines_of(held)[Source.SOURCE_DISTANCE]
    moved = ray_error(SCANNER, held.frame, farther.frame)
    assert line.rays_mm == pytest.approx(moved.rms_mm, rel=0.15)
    assert line.rays_mm == pytest.approx(line.rays_mm_per_unit * 1.0)


@pytest.mark.nightly
def test_scans_with_other_noise_scatter_as_the_line_of_noise_says(calibrated):
    """100 scans know the RMS of about two independent errors to 5 %."""
    found = [calibrated(seed, views=90) for seed in range(2300, 2400)]
    seen = np.cov([to_vector(each.frame) for each in found], rowvar=False)
    scattered_mm = predicted_ray_error(SCANNER, FRAME, seen, radius_mm=found[0].radius_mm).rms_mm
    stated_mm = np.sqrt(np.mean([lines_of(each)[Source.NOISE].rays_mm ** 2 for each in found]))
    assert scattered_mm == pytest.approx(stated_mm, rel=0.15)
