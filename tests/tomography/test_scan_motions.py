"""Motions during a log's scan, by exact chords: a wobbling axis, a slide, and views over another turn than stated."""

import math

import numpy as np
import pytest
from exact_chords import Detector, scan

from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_tomography.drift.levelled_rays import LevelledRays
from sawmill_tomography.drift.view_pairs.behind_metal import rays_behind_metal
from sawmill_tomography.drift.view_pairs.pair_sums import PairSums, ScanMotions, motion_sizes
from sawmill_tomography.geometry.geometry import TAU, Scanner, SourceFrame
from sawmill_tomography.phantoms.phantom import Disc, Polygon
from sawmill_vocabulary import DetectorModule, Rotation

pytestmark = pytest.mark.usefixtures("one_thread")

FRAME = SourceFrame(0.4, 800.0, 1400.0, 12.0, 0.03)
LOG = (
    Disc((7.0, -4.0), 105.0, 0.008),
    Disc((1.0, 2.0), 55.0, -0.001),
    Disc((45.0, 30.0), 14.0, 0.004),
    Disc((-50.0, 20.0), 10.0, 0.005),
)
VIEWS = 20
ANGLES = 0.2 + np.arange(VIEWS) * TAU / VIEWS
TIMES = np.linspace(-0.5, 0.5, VIEWS)


def scanner(*modules):
    return Scanner(
        source_to_cor_mm=800.0, num_detector_pixels=768, detector_pitch_mm=1.5, detector_modules=tuple(modules)
    )


def rays(*, log=LOG, angles=ANGLES, moved_mm=0.0, modules=(), subrays=4):
    return -np.log(scan(log, Detector(768, 1.5, modules), FRAME, angles, moved_mm=moved_mm, rays=subrays))


def noisy(lines, seed):
    return lines + 0.0015 * np.random.default_rng(seed).standard_normal(lines.shape)


def sums_of(lines):
    """The sums of all pairs, of the rays through the log as they are."""
    cells = (lines > 1e-9).any(axis=0)
    inside = lines[:, cells]
    none = np.zeros((inside.shape[1], inside.shape[1]))
    levelled = LevelledRays(inside, np.full(inside.shape, 1e-6), cells, np.zeros((3, cells.sum())), np.eye(23), none)
    without_metal = rays_behind_metal(scanner(), lines, ANGLES, FRAME, None)
    return PairSums.of(scanner(), levelled, without_metal, ANGLES, VECTOR, FRAME.source_distance_mm)


VECTOR = np.array([FRAME.cor_column_mm, FRAME.tilt_rad, FRAME.source_to_detector_mm])


def test_sums_change_by_each_motion_as_exact_scans_do():
    motions = ScanMotions.of_scan(ANGLES, TIMES)
    still = sums_of(rays())
    changes, before = still.moved(VECTOR, motions), still.differences(VECTOR)
    for number, kind in enumerate(motions.kinds):
        size = 0.2 if kind == "turn" else 1.0
        moved = rays(
            angles=ANGLES + size * motions.turned_rad[:, number], moved_mm=size * motions.moved_mm[..., number].T
        )
        exact = (sums_of(moved).differences(VECTOR) - before) / size
        # Gains of the views are no part of the changes; the rest is second order, and how cells sample the edges.
        assert np.corrcoef(changes[:, number], exact)[0, 1] > 0.99, kind
        assert np.abs(changes[:, number] - exact).max() < 0.2 * np.abs(exact).max(), kind


def test_a_shift_of_the_log_with_its_turn_changes_nothing():
    """Once a turn across and along the beam together: the log stands elsewhere on the turntable."""
    motions = ScanMotions.of_scan(ANGLES, TIMES)
    across, along = motions.moved_mm
    # Cosine across and minus sine along.
    amplitudes = np.zeros(len(motions.kinds))
    wobble = motions.kinds.index("wobble")
    amplitudes[wobble], amplitudes[wobble + 5] = 1.0, -1.0
    assert np.hypot(across @ amplitudes, along @ amplitudes) == pytest.approx(0.2)
    changes = sums_of(rays()).moved(VECTOR, motions)
    assert np.abs(changes @ amplitudes).max() < 1e-9 * np.abs(changes).max()


@pytest.mark.parametrize("motion", ["wobble", "slide", "turn"])
def test_motions_are_found_and_leave_the_centre(motion):
    """They were refused as logs that moved, or moved u_c by several standard deviations."""
    angles, moved = ANGLES, np.zeros((VIEWS, 2))
    if motion == "turn":
        angles = ANGLES[0] + (ANGLES - ANGLES[0]) * 356.0 / 360.0
    elif motion == "wobble":
        moved[:, 0] = 0.3 * np.cos(ANGLES + 1.0) + 0.2 * np.cos(2.0 * ANGLES)
    else:
        moved[:, 0] = 0.6 * TIMES
    fit = detector_fit(scanner(), noisy(rays(angles=angles, moved_mm=moved), 1), ANGLES, FRAME, Rotation.AS_GIVEN)
    assert abs(fit.cor_column_mm - FRAME.cor_column_mm) < 3.0 * fit.deviation[0] < 0.2
    assert any(remark.startswith("during the scan the log moved by up to ") for remark in fit.adjustments)


def test_a_scan_that_keeps_still_loses_little_and_no_motion_is_named():
    for seed in range(3):
        fit = detector_fit(scanner(), noisy(rays(), seed), ANGLES, FRAME, Rotation.AS_GIVEN)
        assert abs(fit.cor_column_mm - FRAME.cor_column_mm) < 3.0 * fit.deviation[0] < 0.05
        assert not any(remark.startswith("during the scan") for remark in fit.adjustments)


def test_a_log_whose_edge_falls_into_a_gap_between_modules_is_no_log_that_moved():
    modules = (DetectorModule(258, 2.7, 0.003), DetectorModule(512, 2.5, 0.002))
    fit = detector_fit(scanner(*modules), noisy(rays(modules=modules), 2), ANGLES, FRAME, Rotation.AS_GIVEN)
    assert abs(fit.cor_column_mm - FRAME.cor_column_mm) < 3.0 * fit.deviation[0] < 0.2


def test_sizes_are_those_that_the_differences_show():
    rng = np.random.default_rng(3)
    known = np.linalg.qr(rng.standard_normal((120, 10)))[0]
    motions, kinds = 30.0 * rng.standard_normal((120, 8)), ("wobble",) * 5 + ("slide",) * 3
    noise = rng.standard_normal(120)
    still = motion_sizes(noise, known, motions, kinds)
    assert not still.found
    assert still.shares.max() < 0.02
    wobbling = motion_sizes(noise + motions[:, :5] @ (0.3 * rng.standard_normal(5)), known, motions, kinds)
    assert wobbling.found
    assert 0.1 < wobbling.shares[0] < 1.0
    assert math.isclose(wobbling.shares[0], wobbling.shares[4])
    assert wobbling.shares[7] < 0.02


@pytest.mark.parametrize("seed", [15, 18, 23])
def test_motions_at_once_are_found_where_a_turn_changes_what_the_others_do(seed):
    """45 views over 3 degrees more or less than a turn, a wobble twice a turn and a slide: up to 3 deviations off."""
    rng, views = np.random.default_rng(seed), 45
    orders, around = np.arange(2, 7), np.arange(96) * TAU / 96
    waves, phases = rng.normal(0.0, 0.06 / orders**1.3), rng.uniform(0.0, TAU, (5, 1))
    outline = 100.0 * (1.0 + waves @ np.cos(np.outer(orders, around) + phases))
    corners = outline[:, None] * np.stack([np.cos(around), np.sin(around)], axis=1) + rng.normal(0.0, 9.0, 2)
    log = (Polygon(tuple(map(tuple, corners.tolist())), 0.008), *LOG[1:])
    angles = 0.2 + np.arange(views) * TAU / views
    true = angles[0] + (angles - angles[0]) * rng.choice([357.0, 363.0]) / 360.0
    phase, towards, aspect = rng.uniform(0.0, TAU, 3)
    wobble = 0.3 * np.stack([np.cos(2.0 * true + phase), math.cos(aspect) * np.sin(2.0 * true + phase)], axis=1)
    slide = np.stack([np.cos(towards - true), np.sin(towards - true)], axis=1)
    moved = wobble + 0.9 * np.linspace(-0.5, 0.5, views)[:, None] * slide
    lines = noisy(rays(log=log, angles=true, moved_mm=moved), seed)
    fit = detector_fit(scanner(), lines, angles, FRAME, Rotation.AS_GIVEN)
    assert abs(fit.cor_column_mm - FRAME.cor_column_mm) < 2.0 * fit.deviation[0] < 0.05
