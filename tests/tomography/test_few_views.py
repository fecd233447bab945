"""Drift from few views of a body that hardens the beam: pairs of views and opposite rays, each by its covariance."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_tomography.drift.view_pairs.view_pairs import view_pair_fit
from sawmill_tomography.geometry.geometry import TAU, Scanner, SourceFrame
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_vocabulary import Rotation

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_thread")]

LABORATORY = Scanner(source_to_cor_mm=410.0, num_detector_pixels=560, detector_pitch_mm=0.2)
FRAME = SourceFrame(0.0, 410.0, 554.0, -0.05, 0.003)
NOMINAL = replace(FRAME, cor_column_mm=0.0, tilt_rad=0.0)


def turn(views):
    return np.arange(views) * TAU / views


def hardened_scan(views, seed, first=0.0, position_mm=(0.0, 0.0)):
    """A disc of 70 mm with holes, 29 % hardening on the longest path, gains of 0.3 %, noise of 0.3 %."""
    rng = np.random.default_rng(seed)
    holes = [
        Disc((12.0 * math.cos(a), 14.0 * math.sin(a)), rng.uniform(3.0, 8.0), -1.0) for a in rng.uniform(0, TAU, 3)
    ]
    body = Phantom("disc", (Disc((0.4, -0.3), 35.0, 1.0), *holes))
    angles = first + turn(views)
    rays = project(body, DetectorCells.of(LABORATORY), FRAME, angles, position_mm=position_mm)
    share = rays / rays.max()
    hard = rays * (1.0 - 0.4 * share + 0.11 * share**2)
    gains = 1.0 + 0.003 * rng.standard_normal((views, 1))
    return hard * gains + 0.003 * rays.max() * rng.standard_normal(rays.shape), angles


@pytest.mark.parametrize(("views", "worst_mm"), [(18, 0.02), (20, 0.02), (45, 0.01)])
def test_a_hard_beam_does_not_pass_for_a_log_that_moved(views, worst_mm):
    """A cell is 0.2 mm. Pairs of views alone refused such scans, or were up to a cell off."""
    errors, shares = [], []
    for seed in range(6):
        rays, angles = hardened_scan(views, seed, 0.3 * seed)
        fit = detector_fit(LABORATORY, rays, angles, NOMINAL, Rotation.AS_GIVEN)
        errors.append(fit.cor_column_mm - FRAME.cor_column_mm)
        shares.append(errors[-1] / fit.deviation[0])
    assert math.sqrt(np.mean(np.square(errors))) < worst_mm
    # The RMS of 6 standard normal numbers is below 1.8 in 99.7 % of draws.
    assert math.sqrt(np.mean(np.square(shares))) < 1.8


def test_views_with_gaps_are_compared_by_pairs_alone():
    rays, angles = hardened_scan(45, 1)
    kept = np.delete(np.arange(45), [7, 8])
    alone, fit = (
        each(LABORATORY, rays[kept], angles[kept], NOMINAL, Rotation.AS_GIVEN) for each in (view_pair_fit, detector_fit)
    )
    assert (fit.cor_column_mm, fit.deviation[0]) == (alone.cor_column_mm, alone.deviation[0])


@pytest.mark.parametrize("views", [30, 45])
def test_a_jump_of_a_cell_is_refused_even_where_hardening_hides_it_from_pairs_of_views(views):
    """Half a turn before the jump and half after it: u_c was off by a third of a cell, 9 to 13 standard deviations."""
    moved = np.where(np.arange(views)[:, None] < views // 2, 0.0, 0.148) * [-0.2, -0.98]
    rays, angles = hardened_scan(views, 2, position_mm=moved)
    with pytest.raises(DriftError, match=r"as those of a log that moved by 0\.1[2-6] mm") as refusal:
        detector_fit(LABORATORY, rays, angles, NOMINAL, Rotation.AS_GIVEN)
    assert refusal.value.code == "moved-too-far"


@pytest.mark.parametrize(("views", "away"), [(20, 0.0), (20, 1e-9), pytest.param(180, 0.0, marks=pytest.mark.nightly)])
def test_views_at_0_and_at_360_degrees_stand_at_one_place(views, away):
    rays, angles = hardened_scan(views, 1)
    once_more = rays[0] + 0.004 * rays.max() * np.random.default_rng(2).standard_normal(rays[0].size)
    rays, angles = np.vstack([rays, once_more]), np.append(angles, TAU - away)
    fit = detector_fit(LABORATORY, rays, angles, NOMINAL, Rotation.AS_GIVEN)
    assert abs(fit.cor_column_mm - FRAME.cor_column_mm) < 3.0 * fit.deviation[0] < 0.1
