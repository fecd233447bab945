"""A calibration says that it gets on between the rounds of its search and after them."""

import math
from itertools import pairwise

import numpy as np
import pytest

from sawmill_calibration.calibration import calibrate
from sawmill_calibration.calibration.calibrate import (
    SEARCH_DONE,
    STEPS_EVERY_S,
    CalibrationInput,
    SearchProgress,
    run_calibration,
)
from sawmill_contracts.calibrations import CalibrationOptions
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS
from sawmill_tomography.geometry.geometry import TAU


@pytest.mark.slow
def test_the_fits_after_the_search_are_progress(sinogram, constants, monkeypatch):
    monkeypatch.setattr(calibrate, "STEPS_EVERY_S", 0.0)
    angles = (np.arange(40) + 0.5) * TAU / 40
    given = CalibrationInput(sinogram(angles), angles, (0, 1), constants, None, BUILT_IN_PHANTOMS["l-shape"], "0" * 64)
    reported = []
    run_calibration(given, CalibrationOptions(), reported.append)
    last_round = max(i for i, one in enumerate(reported) if i == 0 or one.generation != reported[i - 1].generation)
    assert last_round > 5, "steps of the search"
    assert len(reported) - last_round > 5, "steps of the fits"
    fractions = [one.fraction for one in reported]
    assert fractions == sorted(fractions)
    assert fractions[-1] < SEARCH_DONE


def test_steps_without_end_go_on_being_progress():
    now_s, reported = [0.0], []
    reporting = SearchProgress(reported.append, 0.5, monotonic=lambda: now_s[0])
    for _ in range(2000):
        now_s[0] += STEPS_EVERY_S
        reporting.on_step()
    # After a million steps too, the next hundred are another fraction: it approaches its end by 1 / n.
    for _ in range(1_000_000):
        reporting.on_step()
    for _ in range(2):
        for _ in range(99):
            reporting.on_step()
        now_s[0] += STEPS_EVERY_S
        reporting.on_step()
    fractions = [one.fraction for one in reported]
    assert all(now > before for before, now in pairwise(fractions))
    assert fractions[-1] < SEARCH_DONE


def test_steps_are_told_once_a_second_and_rounds_at_once():
    now, reported = [0.0], []
    reporting = SearchProgress(reported.append, 0.0, monotonic=lambda: now[0])
    for _ in range(50):
        now[0] += 0.1
        reporting.on_step()
    assert 4 <= len(reported) <= 5
    reporting.on_round(1, 3, math.inf)
    assert (reported[-1].generation, reported[-1].best_value) == (1, None)
