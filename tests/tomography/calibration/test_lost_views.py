"""Scans that lost views: the angles belong to other views, and each view gets the angle that it shows."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.support.exact_chords import FRAME, Detector, counted, full_turn, scan

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.refusals import CalibrationError
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_vocabulary import Adjustment, Rotation, Scanner

CELLS, PITCH_MM = 256, 4.5
SCANNER = Scanner(859.46, CELLS, PITCH_MM)
VIEWS = 60


def task(angles_rad, given_rad, *, shown=L_SHAPE, turned_rad=0.0, **options):
    """A scan in counts at these angles, to which other angles are given."""
    wood = [replace(shape, density=0.008 * shape.density) for shape in shown.shapes]
    lines = counted(scan(wood, Detector(CELLS, PITCH_MM), FRAME, angles_rad, turned_rad=turned_rad, rays=3), seed=1)
    return CalibrationTask(SCANNER, L_SHAPE, lines, given_rad, from_counts=True, **options)


def lost_of_a_turn(lost, *, spread):
    """Angles of the views that remain, and the angles given: spread over the turn, or counted on from the first."""
    remaining = np.delete(full_turn(VIEWS), lost)
    return remaining, full_turn(len(remaining)) if spread else full_turn(VIEWS)[: len(remaining)]


def assert_right(found):
    off = ray_error(SCANNER, FRAME, found.frame, radius_mm=found.radius_mm).rms_mm
    assert found.judgement.rays_verdict == "pass"
    # One realisation of the noise in these cases: up to 1.5 times the bound of 95 %.
    assert off < 1.5 * found.findings.error_bars.predicted_ray_error.upper_95_mm
    return " ".join(found.judgement.reasons)


@pytest.mark.parametrize(
    ("lost", "spread", "sentences"),
    [
        (np.arange(54, 60), True, ["turns 0.9000 times as far as the angles say: were views lost at the end?"]),
        (np.arange(27, 33), True, ["turns 0.9", "jump by 36 degrees at view 27: were 6 views lost?"]),
        (np.arange(40, 49), False, ["jump by 54 degrees at view 40: were 9 views lost?"]),
        ([7, 18, 19, 33, 41, 52], True, ["6 views seem to be lost at random, at 5 places"]),
    ],
    ids=["the end", "a block of a turn", "a block", "at random"],
)
def test_lost_views_are_counted_and_leave_the_rays_right(lost, spread, sentences):
    """Without this the scans failed with rays up to 2.7 mm off, or were refused."""
    reasons = assert_right(calibrate(task(*lost_of_a_turn(lost, spread=spread))))
    assert all(sentence in reasons for sentence in sentences)


def test_lost_views_are_counted_in_either_sense_of_rotation():
    """The angles are given the other way round and from another first angle."""
    angles, given = lost_of_a_turn(np.arange(27, 33), spread=False)
    found = calibrate(task(angles, 0.7 - given, rotation=Rotation.REVERSED))
    reasons = " ".join(found.judgement.reasons)
    assert "jump by 36 degrees at view 27: were 6 views lost?" in reasons
    assert found.frame.source_distance_mm == pytest.approx(FRAME.source_distance_mm, abs=1.5)


def test_lost_views_are_not_counted_where_slips_are_switched_off():
    angles, given = lost_of_a_turn(np.arange(57, 60), spread=True)
    found = calibrate(task(angles, given, without=frozenset({Adjustment.SLIP})))
    assert "lost" not in " ".join(found.judgement.reasons)


def test_angles_that_swing_are_not_taken_for_lost_views():
    angles = full_turn(VIEWS)
    found = calibrate(task(angles, angles, turned_rad=math.radians(4.0) * np.sin(angles)))
    assert "lost" not in " ".join(found.adjustments)


def test_a_jump_of_part_of_a_step_is_a_jump():
    angles = full_turn(VIEWS)
    reasons = assert_right(calibrate(task(angles, angles, turned_rad=math.radians(9.0) * (np.arange(VIEWS) >= 20))))
    assert "jump by 9.0 degrees at view 20. " in reasons


def test_another_built_in_drawing_that_explains_the_scan_is_named():
    angles = full_turn(20)
    sentence = "the built-in drawing 'rectangle-with-hole' explains the scan: was that phantom scanned"
    with pytest.raises(CalibrationError, match=sentence) as refusal:
        calibrate(task(angles, angles, shown=RECTANGLE_WITH_HOLE))
    assert refusal.value.code == "phantom-not-seen"
