"""The rival of the product's search: differential evolution in the source frame on the same coarse misfit.

best/1/bin, crossover 0.7, as arXiv 2206.14444 uses on its own objective. Both searches end in the same least squares.
"""

import time

import numpy as np
from scipy.optimize import Bounds, differential_evolution

from sawmill_tomography.calibration.calibrate import conclude
from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.fit import Fit, refine
from sawmill_tomography.calibration.search.misfit import Candidate, CoarseMisfit, coarse_data, search_box
from sawmill_tomography.calibration.search.search import SearchReport, SearchResult
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.calibration.task import CalibrationTask, PoseHypothesis
from sawmill_tomography.geometry.geometry import FloatArray


def calibrate_by_evolution(task: CalibrationTask, *, seed: int) -> CalibrationOutcome:
    """Calibrate like `calibrate`, with differential evolution as the search."""
    started = time.perf_counter()
    sinogram, angles, cells = coarse_data(task.scanner, task.sinogram, task.angles_rad)
    misfit = CoarseMisfit(task.phantoms, task.rotations, sinogram, angles, cells)
    box = search_box(task.scanner, task.bounds, task.phantom)
    best: dict[PoseHypothesis, Candidate] = {}

    def objective(vector: FloatArray) -> float:
        least = 2.0
        for hypothesis, candidate in misfit(vector).items():
            least = min(least, candidate.misfit)
            if hypothesis not in best or candidate.misfit < best[hypothesis].misfit:
                best[hypothesis] = candidate
        return least

    outcome = differential_evolution(
        objective,
        Bounds(box[:, 0], box[:, 1]),
        strategy="best1bin",
        recombination=0.7,
        mutation=(0.5, 1.0),
        popsize=10,
        maxiter=30,
        tol=0.0,
        atol=2e-4,
        polish=False,
        init="sobol",
        rng=np.random.default_rng(seed),
    )
    fits: dict[PoseHypothesis, list[Fit]] = {}
    for hypothesis, candidate in best.items():
        handedness, rotation = hypothesis
        data = SinogramData(sinogram, rotation.apply(angles), cells)
        fit = refine(task.phantoms[handedness], data, candidate.frame)
        if fit is not None:
            fits[hypothesis] = [fit]
    report = SearchReport(
        "differential-evolution",
        seed,
        misfit.evaluations,
        int(outcome.nit),
        float(outcome.fun),
        bool(outcome.success),
        str(outcome.message),
    )
    return conclude(task, SearchResult(fits, report), started=started, searched=time.perf_counter())
