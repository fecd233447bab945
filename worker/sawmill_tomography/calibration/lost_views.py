"""Views that were lost: the angles of a scan belong to other views, and each view gets the angle that it shows.

Where views were lost at the end and the angles are spread over a full turn, all angles are too large by one factor. A
block of lost views makes the angles jump at one view, views lost at random at several. From a fit that explains a scan
badly the angle of each view is measured; steps of twice the usual size and more count the views lost in between. Where
the fit is too far off, factors and jumps are first compared with the coarse sinogram.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sawmill_tomography.calibration.alternatives import CONTENDER, RankedFit
from sawmill_tomography.calibration.fit import Fit, OnStep, ignore_progress, refine
from sawmill_tomography.calibration.joint_fit.effects import PACE, Effect, of_angle
from sawmill_tomography.calibration.joint_fit.finding import KnownEffect
from sawmill_tomography.calibration.search.misfit import COARSE_VIEWS, TURNS, Candidate
from sawmill_tomography.calibration.search.search import (
    COARSE_ITERATIONS,
    coarse_misfit,
    geometry_box,
    guesses_from_shadow,
)
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.calibration.task import CalibrationTask, PoseHypothesis
from sawmill_tomography.geometry.fit_parameters import FitParameter, GramTerm
from sawmill_tomography.geometry.geometry import TAU, FloatArray
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_vocabulary import Adjustment, Rotation
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.scan_messages import EffectMessage

# Shares of all views that were lost at the end, or in one block at each of these places of the scan.
SHARES, PLACES = np.linspace(0.0125, 0.15, 12), np.linspace(0.08, 0.92, 13)
# The best choices of the table are fitted coarsely, and those of the fits that contend measure the angles of the views.
FITTED_COARSELY = 12
# Rounds of measured angles and geometry, and Newton steps of the measurement in a round.
ROUNDS = 4
# At most this number of views in a row have a wrong measured angle; each may have a neighbour's.
WRONG_IN_A_ROW = 5
# A jump that is farther from whole steps, in steps, is no loss of views.
NOT_WHOLE = 0.1


@dataclass(frozen=True)
class AnglesOfViews:
    """Angles that a scan shows instead of those given."""

    angles_rad: FloatArray  # (views,): in the sense in which the angles were given
    effects: tuple[KnownEffect, ...]  # what the angles have against those given
    ranked: RankedFit


def shown_angles(
    task: CalibrationTask, plain: RankedFit, seed: int | None, on_step: OnStep = ignore_progress
) -> AnglesOfViews | None:
    """Find the angles that the views show, from a plain fit and, with a seed, from factors and jumps of the angles.

    The result is None where the views show the angles given, or where these are not equidistant.
    """
    steps = np.diff(task.angles_rad)
    usual = float(np.median(steps))
    if usual == 0.0 or (np.round(steps / usual) != 1.0).any():
        return None
    starts = [(plain, task.angles_rad), *([] if seed is None else _coarse_fits(task, seed, on_step))]
    found = [_measured(task, start, angles, on_step) for start, angles in starts]
    return min(
        (one for one in found if one is not None), key=lambda one: one.ranked.fit.relative_residual, default=None
    )


def _choices(angles_rad: FloatArray) -> FloatArray:
    """Return the angles (choices, views) under each factor of their spread, and under each jump they may lack."""
    views, from_first = len(angles_rad), angles_rad - angles_rad[0]
    turn = float(from_first[-1]) * views / (views - 1)
    after = np.arange(views) >= np.round(PLACES * views)[:, None]
    spread = [(1.0 - share) * from_first + share * turn * after for share in SHARES]
    counted = [from_first + share / (1.0 - share) * turn * after for share in SHARES]
    return np.asarray(
        angles_rad[0]
        + np.concatenate([np.array([1.0, *(1.0 - SHARES), *(1.0 + SHARES)])[:, None] * from_first, *spread, *counted])
    )


def _coarse_fits(task: CalibrationTask, seed: int, on_step: OnStep) -> list[tuple[RankedFit, FloatArray]]:
    """Fit the best choices of the angles to the coarse sinogram: the best fits, each with its angles (views,)."""
    misfit, choices = coarse_misfit(task), _choices(task.angles_rad)
    usable = np.flatnonzero(task.screening.views)
    coarse = choices[:, usable[:: max(1, len(usable) // COARSE_VIEWS)]]
    best: dict[tuple[PoseHypothesis, int], Candidate] = {}
    for guess in guesses_from_shadow(misfit, task, geometry_box(task), np.random.default_rng(seed)):
        on_step()
        for hypothesis, candidates in misfit.with_angles(guess, coarse).items():
            for number, candidate in enumerate(candidates):
                before = best.get((hypothesis, number))
                if before is None or candidate.misfit < before.misfit:
                    best[hypothesis, number] = candidate
    fits = []
    for hypothesis, number in sorted(best, key=lambda choice: best[choice].misfit)[:FITTED_COARSELY]:
        data = SinogramData(misfit.sinogram, hypothesis.rotation.apply(coarse[number]), misfit.cells)
        start = best[hypothesis, number].frame
        fit = refine(
            task.phantoms[hypothesis.handedness], data, start, max_iterations=COARSE_ITERATIONS, on_step=on_step
        )
        if fit is not None:
            fits.append((RankedFit(hypothesis, fit), choices[number]))
    # The first of the choices are the angles given: choices that explain no more are not what the views show.
    given = [ranked.fit.relative_residual for ranked, angles in fits if np.array_equal(angles, choices[0])]
    most = min([CONTENDER * ranked.fit.relative_residual for ranked, _ in fits] + given, default=0.0)
    return [one for one in fits if one[0].fit.relative_residual < most]


def _measured(task: CalibrationTask, start: RankedFit, angles_rad: FloatArray, on_step: OnStep) -> AnglesOfViews | None:
    """Measure the angles from a fit with these angles, and fit again, several times."""
    (handedness, rotation), fit = start
    phantom, data = task.phantoms[handedness], replace(task.full_data(rotation), angles_rad=rotation.apply(angles_rad))
    first, from_first = float(task.angles_rad[0]), task.angles_rad - task.angles_rad[0]
    angles, lost, pace = angles_rad, np.zeros(len(from_first)), 1.0
    for _ in range(ROUNDS):
        measured = rotation.apply(_newton(phantom, data, fit))
        taken = np.diff(measured) / np.diff(from_first)
        in_between = np.round(taken / float(np.median(taken))) - 1.0
        # A row that only grows is its own running median.
        row = np.pad(np.append(0.0, np.cumsum(in_between)), WRONG_IN_A_ROW, mode="edge")
        lost = np.median(sliding_window_view(row, 2 * WRONG_IN_A_ROW + 1), axis=1)
        slope, start_rad = np.polyfit(_counted(from_first, lost), measured, 1).tolist()
        for _ in range(WRONG_IN_A_ROW if np.ptp(lost) else 0):
            rows = [lost, np.append(lost[:1], lost[:-1]), np.append(lost[1:], lost[-1:])]
            turns = [rotation.apply(start_rad + slope * _counted(from_first, row)) for row in rows]
            misfits = [_misfit_by_view(phantom, replace(data, angles_rad=turn), fit) for turn in turns]
            lost = np.choose(np.argmin(misfits, axis=0), rows)
            if np.array_equal(lost, rows[0]):
                break
        counted = _counted(from_first, lost)
        pace = float(np.polyfit(counted, measured, 1)[0])
        if round((pace - 1.0) * len(taken)) == 0:  # less than half a step of the last angle is left to the joint fit
            pace = 1.0
        before, angles = angles, first + pace * counted
        data = replace(data, angles_rad=rotation.apply(angles))
        better = refine(phantom, data, fit.frame, position_mm=fit.position_mm, on_step=on_step)
        if better is None:
            return None
        fit = better
        if np.allclose(angles, before):
            break
    if (pace == 1.0 and not np.ptp(lost)) or (np.diff(lost) < 0.0).any():
        return None
    return AnglesOfViews(angles, tuple(_effects(from_first, lost, pace, rotation)), RankedFit(start.hypothesis, fit))


def _counted(from_first: FloatArray, lost: FloatArray) -> FloatArray:
    """Return angles (views,) that go on by as many more steps as views were lost before each view."""
    return np.asarray(from_first + np.append(0.0, np.cumsum(np.diff(from_first) * np.diff(lost))))


def _misfit_by_view(phantom: Phantom, data: SinogramData, fit: Fit) -> FloatArray:
    """Return the sum of squares that the model of a fit leaves in each view at the data's angles, (views,)."""
    squares = (data.sinogram - fit.prediction(phantom, data)) ** 2
    return np.asarray((squares if data.weights is None else data.weights * squares).sum(axis=1))


def _newton(phantom: Phantom, data: SinogramData, fit: Fit) -> FloatArray:
    """Return the angle of each view at the geometry of a fit, (views,), by Newton's steps from the data's angles."""
    x = fit.to_vector()
    for _ in range(ROUNDS):
        of_turn = data.gram(phantom, x)[:, FitParameter.PSI]
        score = (
            of_turn[:, GramTerm.DATA] - fit.gain * of_turn[:, GramTerm.SHADOW] - fit.offset * of_turn[:, GramTerm.ONE]
        )
        information = fit.gain * of_turn[:, FitParameter.PSI]
        step = score / np.maximum(information, 1e-9 * information.max())
        data = replace(data, angles_rad=data.angles_rad + np.clip(step, -TAU / TURNS, TAU / TURNS))
    return data.angles_rad


def _effects(from_first: FloatArray, lost: FloatArray, pace: float, rotation: Rotation) -> Iterator[KnownEffect]:
    """Yield what the angles have against those given: a factor, and views that were lost in between."""
    views, places = len(lost), np.flatnonzero(np.diff(lost)) + 1
    count, step = int(np.ptp(lost)), pace * float(from_first[-1]) / (views - 1)
    if pace != 1.0:
        fewer = EffectMessage.PACE_LOST_VIEWS if count else EffectMessage.PACE_LOST_END
        message = EffectMessage.PACE if pace > 1.0 else fewer
        turned = float(from_first[-1])

        def turns(_: object, sizes: FloatArray) -> Reason:
            return message(factor=1.0 + rotation.apply(float(sizes[0])) / turned)

        sizes = np.array([rotation.apply((pace - 1.0) * turned)])
        yield KnownEffect(replace(PACE, reason=turns), sizes)
    if not count:
        return
    shape = rotation.apply(lost * step)

    def jumps(_: object, sizes: FloatArray) -> Reason:
        if len(places) > 1:
            return EffectMessage.LOST_AT_RANDOM(lost=count, places=len(places))
        steps = count * float(sizes[0])
        jump = {"jump_deg": abs(math.degrees(steps * step)), "view": int(places[0])}
        if abs(steps - count) < NOT_WHOLE:
            return EffectMessage.LOST_VIEWS(**jump, lost=count)
        return EffectMessage.ANGLES_JUMP_VIEWS(**jump)

    yield KnownEffect(Effect(Adjustment.SLIP, lambda _: of_angle([shape]), jumps), np.ones(1))
