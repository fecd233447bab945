"""Marks of a log on fixed pairs in three dimensions, and whether the pairs agree, against what was simulated."""

from dataclasses import replace

import numpy as np
import pytest
from fixed_pairs import machine
from pair_logs import ROW_PITCH_MM, log_lines

from sawmill_tomography.geometry.geometry import TAU, FanViews, GeometryError, SourceFrame, rotate, to_vector
from sawmill_tomography.pairs.agreement import agreement, shadow_middles
from sawmill_tomography.pairs.log_pictures import LogPictures, log_pictures
from sawmill_tomography.pairs.marks import Mark, Sights
from sawmill_tomography.phantoms.phantom import Phantom, Polygon
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_vocabulary import PairedScanner

RAYS_MM, SCALE = 0.02, 0.001


@pytest.mark.slow
def test_nails_are_located_within_a_millimetre_and_a_pair_that_has_moved_is_named_with_its_motion():
    scanner, true = machine(4, np.random.default_rng(4))
    fewer = {"num_detector_pixels": 384, "detector_pitch_mm": 2.4}
    scanner = PairedScanner(tuple(replace(pair, **fewer) for pair in scanner.pairs))
    stacks, metal = log_lines(scanner, true, 4, 30)
    moved = to_vector(true[1]) + np.array([0.0, 0.0, 0.0, 3.0 * true[1].magnification, 0.0])
    calibrated = [true, [true[0], SourceFrame.from_vector(moved), *true[2:]]]
    pictures = [log_pictures(stacks, scanner.pairs, frames, ROW_PITCH_MM) for frames in calibrated]
    of_true, of_moved = (Sights.of(each, np.full(4, RAYS_MM), SCALE) for each in pictures)
    off = np.array([[np.linalg.norm(body.place_mm - place) for body in of_true.bodies()] for place in metal])
    assert off.min(axis=1).max() < 1.0
    assert off.min(axis=0).max() < 1.0  # no false mark
    still, after = (agreement(each, 1.0) for each in (of_true, of_moved))
    assert (still.state, still.suspect) == ("agree", None)
    assert (np.abs(still.moved_mm) < still.within_mm).all()
    assert (after.state, after.suspect) == ("disagree", 2)
    assert abs(after.moved_mm[1]) == pytest.approx(3.0, abs=2.0 * after.within_mm[1])


def sights_of_points(angles_deg, points):
    """Return the marks of points (n, 3), each in all pairs, which are at these angles, 800 mm from the centre."""
    angles = np.deg2rad(angles_deg)
    axis = np.stack([np.cos(angles), np.sin(angles)], -1)
    source = 800.0 * np.stack([axis[:, 1], -axis[:, 0]], -1)
    cells = np.arange(-200.0, 200.0)
    views = FanViews.of(source, 0.0 * source, axis, cells[:, None] + np.array([-0.5, 0.5]))
    depths = 800.0 - points[:, :2] @ source.T / 800.0
    u = 800.0 * points[:, :2] @ axis.T / depths
    marks = [[Mark(at, 1.0, height) for at, height in zip(own, points[:, 2], strict=True)] for own in u.T]
    pictures = LogPictures(np.zeros((len(angles), 3, 400)), np.array([0.0, 2.0, 4.0]), cells, views)
    return Sights(pictures, marks, np.full(len(angles), RAYS_MM), SCALE)


def test_two_marks_at_one_height_are_ambiguous_for_two_pairs_and_not_for_three():
    points = np.array([[40.0, 30.0, 2.0], [-50.0, 10.0, 2.0], [5.0, -60.0, 40.0]])
    two = sights_of_points([0.0, 90.0], points)
    assert agreement(two, 1.0).state == "unknown"  # rays of two pairs always meet
    bodies = two.bodies()
    assert [body.is_ambiguous for body in bodies] == [True] * 4 + [False]
    for point in points:  # the true places are among them
        assert min(np.linalg.norm(body.place_mm - point) for body in bodies) < 0.01
    three = sights_of_points([0.0, 60.0, 120.0], points).bodies()
    assert [body.is_ambiguous for body in three] == [False] * 3
    assert np.linalg.norm(three[2].place_mm - points[2]) < 0.01


def test_the_middle_of_a_heavy_ellipse_is_where_its_shadows_say():
    (scanner, true), turn = machine(4, np.random.default_rng(1)), np.linspace(0.0, TAU, 400, endpoint=False)
    x, y = rotate(0.6, 120.0 * np.cos(turn), 90.0 * np.sin(turn))
    ellipse = Phantom("ellipse", (Polygon(tuple(zip(12.0 + x, y - 7.0, strict=True)), 0.02),))
    cells = [DetectorCells.of(pair.scanner) for pair in scanner.pairs]
    lines = [project(ellipse, of_pair, frame, np.zeros(3)) for of_pair, frame in zip(cells, true, strict=True)]
    normals, distances = shadow_middles(log_pictures(lines, scanner.pairs, true, 2.0))
    assert distances == pytest.approx(normals @ [12.0, -7.0], abs=0.05)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda lines: np.roll(lines, 384, axis=1), "the log leaves the detector of pair 1"),
        (lambda lines: lines * (np.arange(len(lines)) < 4)[:, None], "pair 1 shows a log in less than half"),
    ],
)
def test_a_log_that_a_pair_does_not_show_whole_is_refused(change, sentence):
    scanner, true = machine(2, np.random.default_rng(1))
    lines = np.tile(np.maximum(1.0 - (np.arange(768) - 384) ** 2 / 1e4, 0.0), (9, 1))
    with pytest.raises(GeometryError, match=sentence):
        log_pictures([change(lines), lines], scanner.pairs, true, 2.0)
