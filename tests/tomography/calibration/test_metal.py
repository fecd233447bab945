"""Metal in the phantom: starved rays are found, left out and reported, and the rest calibrates as if it were not there.

Counts with ten flats, wood of 0.005/mm as hard radiation sees it, steel 16 and 100 times as dense.
"""

from dataclasses import replace

import numpy as np
import pytest
from mill_scans import line_integrals

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import TAU, Scanner, Theta
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.phantom import Disc, Polygon
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import Adjustment

pytestmark = pytest.mark.slow

SCANNER = Scanner(859.46, 384, 3.0)
FRAME = Theta(1.2, 741.0, 212.0, 31.0, 0.17).source_frame(859.46)
POSITION = (4.0, -7.0)
WOOD_PER_MM, RAYS = 0.005, 6
SCREWS = ((-60.0, -20.0), (50.0, 100.0), (45.0, -100.0), (-40.0, 100.0))
BRACKET = ((20.0, 70.0), (70.0, 70.0), (70.0, 72.5), (20.0, 72.5))


def scan(phantom, *grown, views=60, photons=10_000.0, seed=1):
    """What is asked of the calibration of a phantom in which something is (density in wood, beside the wood's)."""
    rng = np.random.default_rng(seed)
    angles = (np.arange(views) + 0.5) * TAU / views
    cells = DetectorCells.of(SCANNER)
    fine = DetectorCells(cells.first_border_mm, cells.width_mm / RAYS, cells.count * RAYS)
    whole = replace(phantom, shapes=(*phantom.shapes, *grown)).of_density(WOOD_PER_MM)
    lengths = analytic.project(whole, fine, FRAME, angles, position_mm=POSITION, rays_per_cell=1)
    beam = np.exp(-lengths).reshape(views, cells.count, RAYS).mean(axis=2)
    exposed = [rng.poisson(photons * beam), rng.poisson(photons, (10, cells.count))]
    counts, flats = (taken[:, None].astype(np.float32) for taken in exposed)
    stack = line_integrals(counts, flats, None).stack[:, 0].astype(np.float64)
    return CalibrationTask(SCANNER, phantom, stack, angles, from_counts=True)


def metal_reported(found):
    return [sentence for sentence in found.adjustments if sentence.startswith("Metal in the phantom")]


def screws(count, density, radius_mm=2.5):
    return [Disc(at, radius_mm, density - 1.0) for at in SCREWS[:count]]


@pytest.mark.parametrize(
    ("phantom", "views", "photons", "grown"),
    [
        (RECTANGLE_WITH_HOLE, 60, 20_000.0, screws(4, 16.0)),
        (RECTANGLE_WITH_HOLE, 60, 20_000.0, screws(4, 100.0)),
        (L_SHAPE, 20, 3_000.0, screws(3, 16.0)[1:]),
        (RECTANGLE_WITH_HOLE, 45, 20_000.0, [Polygon(BRACKET, 25.0)]),
    ],
    ids=["4 screws", "4 screws that starve the rays", "few views and photons", "bracket"],
)
def test_metal_is_left_out_and_reported(phantom, views, photons, grown):
    found = calibrate(scan(phantom, *grown, views=views, photons=photons))
    assert len(metal_reported(found)) == 1
    # Twice the bound of scans without metal: their noise, and 3 to 9 % of the samples less.
    bound = calibrate(scan(phantom, views=views, photons=photons)).findings.error_bars.predicted_ray_error.upper_95_mm
    assert ray_error(SCANNER, FRAME, found.frame).rms_mm < 2.0 * bound
    assert found.judgement.verdict == "pass"


def test_its_places_are_those_of_the_drawing():
    (sentence,) = metal_reported(calibrate(scan(RECTANGLE_WITH_HOLE, *screws(4, 16.0))))
    for x, y in SCREWS:
        around = [f"({x + dx:.0f}, {y + dy:.0f})" for dx in (-1.0, 0.0, 1.0) for dy in (-1.0, 0.0, 1.0)]
        assert any(place in sentence for place in around), sentence


def test_without_the_adjustment_metal_stays_in():
    found = calibrate(replace(scan(RECTANGLE_WITH_HOLE, *screws(2, 16.0)), without=frozenset({Adjustment.METAL})))
    assert not metal_reported(found)
    assert found.task.screening.weights is None


@pytest.mark.parametrize("phantom", [L_SHAPE, RECTANGLE_WITH_HOLE], ids=lambda phantom: phantom.name)
@pytest.mark.parametrize(
    "grown",
    [[], [Disc((45.0, 90.0), 14.0, 0.5)], [Disc((45.0, 90.0), 4.0, 1.0)]],
    ids=["clean", "large knot", "small knot twice as dense"],
)
def test_wood_is_no_metal(phantom, grown):
    # 2 000 photons: the deepest paths have 400 counts, and their line integrals scatter by 5 %.
    for seed in range(2):
        assert not metal_reported(calibrate(scan(phantom, *grown, views=45, photons=2_000.0, seed=seed)))
