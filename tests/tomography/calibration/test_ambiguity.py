"""Bodies that look the same from several sides, and scans that contradict the scanner: never a pass."""

import numpy as np
import pytest

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.refusals import CalibrationError
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import Scanner, Theta
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.phantom import Disc, Phantom, PhantomError, Polygon, cornered
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_vocabulary import Handedness, Rotation

SCANNER = Scanner(859.46, 768, 1.502864583)
FRAME = Theta(1.2, 741.0, 212.0, 31.0, 0.17).source_frame(859.46)
TWO_DISCS = Phantom("two discs", (Disc((-60.0, 10.0), 40.0), Disc((55.0, -20.0), 25.0)))
SQUARE = Phantom("square", (Polygon(((-60.0, -60.0), (60.0, -60.0), (60.0, 60.0), (-60.0, 60.0))),))


def scan_of(phantom, *, frame=FRAME, views=40, position=(0.0, 0.0), seed=1250):
    angles = np.arange(views) * 2.0 * np.pi / views
    clean = project(phantom, DetectorCells.of(SCANNER), frame, angles, position_mm=position, rays_per_cell=6)
    noise = 0.01 * np.sqrt(np.mean(clean**2)) * np.random.default_rng(seed).standard_normal(clean.shape)
    return clean + noise, angles


@pytest.mark.parametrize("position", [(0.0, 0.0), (12.0, -9.0)])
def test_two_discs_look_the_same_from_behind(position):
    found = calibrate(CalibrationTask(SCANNER, TWO_DISCS, *scan_of(TWO_DISCS, position=position)))
    assert (found.judgement.status, found.judgement.verdict) == ("ambiguous-handedness", "watch")


@pytest.mark.parametrize("position", [(0.0, 0.0), (40.0, 30.0)])
def test_a_square_looks_the_same_turned_wherever_it_stands(position):
    sinogram, angles = scan_of(SQUARE, position=position)
    sides = {"handedness": Handedness.AS_DRAWN, "rotation": Rotation.AS_GIVEN}
    found = calibrate(CalibrationTask(SCANNER, SQUARE, sinogram, angles, **sides))
    assert (found.judgement.status, found.judgement.verdict) == ("ambiguous-turn", "watch")


# The last one is a ring as a program that knows no circles draws it: 96 corners, and a hole traced 0.003 mm off.
ROUND = {
    "disc in the centre": (Disc((0.0, 0.0), 35.0),),
    "disc off the centre": (Disc((30.0, 20.0), 80.0),),
    "ring": (Disc((0.0, 0.0), 35.0), Disc((0.0, 0.0), 20.0, -1.0)),
    "ring of polygons": (cornered(Disc((0.4, -0.2), 35.0)), cornered(Disc((0.403, -0.2), 20.0, -1.0))),
}


@pytest.mark.parametrize("name", ROUND)
def test_a_phantom_that_looks_the_same_from_every_side_is_refused_before_any_fit(name):
    with pytest.raises(PhantomError, match="cannot calibrate: it looks the same from every side"):
        CalibrationTask(SCANNER, Phantom(name, ROUND[name]), *scan_of(SQUARE, views=3))


@pytest.mark.parametrize(
    "hole",
    [
        Disc((0.2, 0.0), 20.0, -1.0),
        Disc((13.0, -11.0), 2.0, -1.0),
        Polygon(((-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0)), -1.0),
    ],
    ids=["a ring off the centre", "a small hole", "a square hole"],
)
def test_a_disc_with_a_hole_that_shows_its_turn_is_not_round(hole):
    assert not Phantom("disc with a hole", (Disc((0.0, 0.0), 35.0), hole)).is_round


def test_a_phantom_far_larger_than_its_drawing_contradicts_the_scanner():
    """Three per cent at 60 mm of source shift: R comes out shorter than r_S, by far more than noise."""
    near = Theta(1.2, 741.0, 60.0, 31.0, 0.17).source_frame(859.46)
    grown = Phantom(
        "grown", tuple(Polygon(tuple((1.03 * x, 1.03 * y) for x, y in s.vertices_mm)) for s in L_SHAPE.shapes)
    )
    found = calibrate(CalibrationTask(SCANNER, L_SHAPE, *scan_of(grown, frame=near)))
    assert (found.judgement.status, found.judgement.verdict) == ("inconsistent-scale", "fail")
    assert "Two measurements contradict each other" in found.judgement.reasons[0]


def test_a_drawing_in_cm_is_refused_by_the_distance_it_asks_for():
    small = Phantom(
        "in cm", tuple(Polygon(tuple((0.1 * x, 0.1 * y) for x, y in s.vertices_mm)) for s in L_SHAPE.shapes)
    )
    with pytest.raises(CalibrationError, match=r"source_to_cor_mm is 859\.46: check that constant, the phantom's size"):
        calibrate(CalibrationTask(SCANNER, small, *scan_of(L_SHAPE)))


def test_a_sinogram_that_vanishes_is_refused():
    sinogram, angles = scan_of(L_SHAPE)
    with pytest.raises(CalibrationError, match="in which they do not vanish"):
        calibrate(CalibrationTask(SCANNER, L_SHAPE, 1e-160 * sinogram, angles))
