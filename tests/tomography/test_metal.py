"""Nails in simulated logs: scans in counts with ten flats, where cells average intensities."""

import numpy as np
import pytest
from scipy.ndimage import label

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.preparing.line_integrals import line_integrals
from sawmill_tomography.projection.simulate import simulate_stack
from sawmill_tomography.reconstruction.metal import MetalSearch
from sawmill_tomography.reconstruction.object_extent import object_radius_mm

MILL = Scanner(source_to_cor_mm=859.46, num_detector_pixels=288, detector_pitch_mm=2.0)
THETA = Theta(0.7, 715.0, 40.0, 10.0, 0.05)
WOOD = LogModel.random(3, radius_mm=105.0).slice_at(60.0).moved(4.0, -3.0)
STEEL_PER_MM = 0.3
NAILS = (Disc((60.0, 20.0), 2.0, STEEL_PER_MM), Disc((-30.0, -55.0), 2.5, STEEL_PER_MM))
NAILED = Phantom("nailed", (*WOOD.shapes, *NAILS))


def scan(body, views, seed=5):
    fan = FanBeamGeometry(MILL, THETA, (np.arange(views) + 0.5) * TAU / views)
    stack = simulate_stack([body], fan, photons=20_000.0, seed=seed)
    counts, flats, darks = (frames.astype(np.float32) for frames in vars(stack).values())
    return line_integrals(counts, flats, darks).stack[:, 0], fan


def search(lines, fan):
    made = MetalSearch.of(fan, object_radius_mm(fan, lines))
    assert made is not None
    return made


@pytest.mark.parametrize("views", [12, 90])
def test_nails_are_found_and_taken_out(views):
    lines, fan = scan(NAILED, views)
    plain, _ = scan(WOOD, views)
    looking = search(lines, fan)
    assert looking.suspects(np.stack([lines, plain])).tolist() == [True, False]
    metal = looking.find(lines)
    assert label(metal.excess > 0.0)[1] == len(NAILS)
    # A nail shades 5 to 7 of 288 cells, with the margin 10 to 12: two of them at most a twelfth.
    assert 0.03 < metal.trace.mean() < 1.0 / 12.0
    assert np.array_equal(metal.filled[~metal.trace], lines[~metal.trace])
    # What is left of 1.2 in the middle of a nail: the noise (0.03) and the rings, which no interpolation knows.
    assert np.sqrt(np.mean((metal.filled - plain)[metal.trace] ** 2)) < 0.1


def test_the_metal_is_put_back_with_its_mass_on_any_grid():
    lines, fan = scan(NAILED, 90)
    metal = search(lines, fan).find(lines)
    mass = STEEL_PER_MM * np.pi * sum(nail.radius_mm**2 for nail in NAILS)
    for grid in (ImageGrid(48, 240.0), ImageGrid(200, 240.0, (10.0, -6.0))):
        # Cells average intensities, and steel shades more than its mass: a few per cent.
        assert metal.on(grid).sum() * grid.pixel_mm**2 == pytest.approx(mass, rel=0.15)


def test_a_scan_that_does_not_go_all_round_is_not_looked_at():
    lines, fan = scan(NAILED, 90)
    assert MetalSearch.of(fan.with_angles(0.25 * fan.angles_rad), object_radius_mm(fan, lines)) is None
