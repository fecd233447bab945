"""Marks of a log on fixed pairs in three dimensions, and whether the pairs agree, against what was simulated."""

from dataclasses import replace

import numpy as np
import pytest
from fixed_pairs import machine
from pair_logs import ROW_PITCH_MM, log_lines

from sawmill_tomography.geometry.geometry import FanViews, GeometryError, SourceFrame, to_vector
from sawmill_tomography.pairs.agreement import agreement, shadow_middles
from sawmill_tomography.pairs.log_pictures import LogPictures, log_pictures
from sawmill_tomography.pairs.marks import Mark, Sights
from sawmill_vocabulary import PairedScanner

RAYS_MM, SCALE = 0.02, 0.001


def nailed(pairs, seed, rows=30):
    """Return a machine with half as many cells, its true frames, and the pictures and metal of a log."""
    scanner, true = machine(pairs, np.random.default_rng(seed))
    fewer = {"num_detector_pixels": 384, "detector_pitch_mm": 2.4}
    scanner = PairedScanner(tuple(replace(pair, **fewer) for pair in scanner.pairs))
    return scanner, true, *log_lines(scanner, true, seed, rows)


def sights(scanner, frames, stacks):
    pictures = log_pictures(stacks, scanner.pairs, frames, ROW_PITCH_MM)
    return Sights.of(pictures, np.full(len(frames), RAYS_MM), SCALE)


@pytest.mark.slow
def test_nails_are_located_within_a_millimetre_and_a_pair_that_has_moved_is_named_with_its_motion():
    scanner, true, stacks, metal = nailed(4, 4)
    bodies = sights(scanner, true, stacks).bodies()
    off = np.array([[np.linalg.norm(body.place_mm - place) for body in bodies] for place in metal])
    assert off.min(axis=1).max() < 1.0
    assert off.min(axis=0).max() < 1.0  # no false mark
    still = agreement(sights(scanner, true, stacks), 1.0)
    assert (still.state, still.suspect) == ("agree", None)
    assert (np.abs(still.moved_mm) < still.within_mm).all()
    calibrated = [to_vector(frame) for frame in true]
    calibrated[1][3] += 3.0 * true[1].magnification
    moved = agreement(sights(scanner, [*map(SourceFrame.from_vector, calibrated)], stacks), 1.0)
    assert (moved.state, moved.suspect) == ("disagree", 2)
    assert abs(moved.moved_mm[1]) == pytest.approx(3.0, abs=2.0 * moved.within_mm[1])


def fan(angles_deg):
    """Return views of pairs at these angles, 800 mm from the centre."""
    angles = np.deg2rad(angles_deg)
    axis = np.stack([np.cos(angles), np.sin(angles)], -1)
    source = 800.0 * np.stack([axis[:, 1], -axis[:, 0]], -1)
    borders = np.arange(-200.0, 200.0)[:, None] + np.array([0.0, 1.0])
    return FanViews.of(source, 0.0 * source, axis, borders)


def marks_at(views, points):
    """Return the marks of points (n, 3) in each view."""
    to = points[:, None, :2] - views.source_mm
    depth = np.einsum("npc,pc->np", to, -views.source_mm / 800.0)
    u = 800.0 * np.einsum("npc,pc->np", to, views.axis) / depth
    return [[Mark(float(at), 1.0, float(height)) for at, height in zip(own, points[:, 2], strict=True)] for own in u.T]


def sights_of_points(angles_deg, points):
    views = fan(angles_deg)
    lines = np.zeros((len(angles_deg), 3, 400))
    pictures = LogPictures(lines, np.array([0.0, 2.0, 4.0]), views.borders_mm.mean(axis=1), views)
    return Sights(pictures, marks_at(views, points), np.full(len(angles_deg), RAYS_MM), SCALE)


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
    views, middle = fan([0.0, 50.0, 100.0, 150.0]), np.array([12.0, -7.0])
    long, short, turn = 120.0, 90.0, 0.6
    half = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) / np.array([[long], [short]])
    cells = views.borders_mm.mean(axis=1)
    to = cells[:, None] * views.axis[:, None] - views.source_mm[:, None]
    start, along = (views.source_mm - middle) @ half.T, to @ half.T
    a, b = (along**2).sum(-1), np.einsum("pmc,pc->pm", along, start)
    root = np.maximum(b**2 - a * ((start**2).sum(-1)[:, None] - 1.0), 0.0)
    chords = 2.0 * np.sqrt(root) / a * np.hypot(*to.transpose(2, 0, 1))
    pictures = LogPictures(0.02 * chords[:, None], np.zeros(1), cells, views)
    normals, distances = shadow_middles(pictures)
    assert distances == pytest.approx(normals @ middle, abs=0.05)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda lines: np.roll(lines, 384, axis=1), "the log leaves the detector of pair 1"),
        (lambda lines: lines * (np.arange(len(lines)) < 4)[:, None], "pair 1 shows a log in less than half"),
        (lambda lines: 0.0 * lines, "pair 1 shows a log in less than half"),
    ],
)
def test_a_log_that_a_pair_does_not_show_whole_is_refused(change, sentence):
    scanner, true = machine(2, np.random.default_rng(1))
    lines = np.tile(np.maximum(1.0 - (np.arange(768) - 384) ** 2 / 1e4, 0.0), (9, 1))
    with pytest.raises(GeometryError, match=sentence):
        log_pictures([change(lines), lines], scanner.pairs, true, 2.0)
