"""Differential evolution against Nelder-Mead and simulated annealing, on equal budgets of the same objective."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from scanners import SCANNER
from scans import ANGLES, TRUE_FRAME
from scipy.optimize import Bounds, differential_evolution, dual_annealing, minimize

from paper import pictures
from paper.experiment import Experiment, Plan, Result, Results, Unit, Values
from paper.searches import MadeOf, default_source, default_unit, every_so_many, phantom_scan
from sawmill_tomography.calibration.paper import PaperObjective, PaperSettings
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import FloatArray, Theta, ThetaBounds, bounds_array
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_vocabulary import Rotation

CHECKPOINTS = 60
# The share of the best J known within which a run counts as a success: SciPy's own default stop.
SUCCESS = 0.01
UNIT_CUBE = Bounds(np.zeros(5), np.ones(5))
SIMPLEX_STEP = 0.15


class BudgetSpentError(Exception):
    """The evaluations are used up."""


class Counted:
    """The published objective over the unit cube; remembers the best, and stops when the budget is spent."""

    def __init__(self, objective: PaperObjective, budget: int) -> None:
        self._objective, self._budget = objective, budget
        bounds = bounds_array(ThetaBounds())
        self._low, self._width = bounds[:, 0], bounds[:, 1] - bounds[:, 0]
        self.scale = objective.scale
        self.best: list[float] = []
        self.vector = self._low

    def __call__(self, x: FloatArray) -> float:
        """Return J at a point of the cube."""
        if len(self.best) >= self._budget:
            raise BudgetSpentError
        vector = self._low + self._width * np.asarray(x)
        value = self._objective(vector)
        if not self.best or value < self.best[-1]:
            self.vector = vector
        self.best.append(min(value, self.best[-1]) if self.best else value)
        return value


def evolve(objective: Counted, rng: np.random.Generator) -> None:
    """Minimise by best/1/bin, crossover 0.7, as published, without a stop."""
    differential_evolution(
        objective, UNIT_CUBE, strategy="best1bin", recombination=0.7, maxiter=10**6, tol=0.0, polish=False, rng=rng
    )


def restart_simplex(objective: Counted, rng: np.random.Generator) -> None:
    """Minimise by Nelder-Mead from one random point after another."""
    while True:
        start = rng.uniform(size=5)
        steps = np.where(start > 0.5, -SIMPLEX_STEP, SIMPLEX_STEP)
        simplex = np.vstack([start, start + np.diag(steps)])
        minimize(
            objective,
            start,
            method="Nelder-Mead",
            bounds=UNIT_CUBE,
            options={"initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-5 * objective.scale},
        )


def anneal(objective: Counted, rng: np.random.Generator) -> None:
    """Minimise by generalised simulated annealing alone."""
    dual_annealing(objective, UNIT_CUBE, maxiter=10**6, maxfun=1e9, no_local_search=True, rng=rng)


def anneal_and_descend(objective: Counted, rng: np.random.Generator) -> None:
    """Minimise by dual annealing with SciPy's local search after each better point."""
    dual_annealing(objective, UNIT_CUBE, maxiter=10**6, maxfun=1e9, rng=rng)


OPTIMISERS: Mapping[str, Callable[[Counted, np.random.Generator], None]] = {
    "differential evolution": evolve,
    "Nelder-Mead, restarted": restart_simplex,
    "simulated annealing": anneal,
    "simulated annealing with local search": anneal_and_descend,
}
STYLES = ((pictures.BLUE, "-"), (pictures.ORANGE, "--"), (pictures.GREEN, "-."), (pictures.PURPLE, ":"))


def run(optimiser: str, seed: int, budget: int, views: int, image_size: int, made_of: MadeOf) -> Result:
    """Run an optimiser to the end of the budget; start again from elsewhere if the optimiser ends by itself."""
    take = every_so_many(views)
    task = CalibrationTask(SCANNER, L_SHAPE, phantom_scan("l-shape", made_of, 0)[take], ANGLES[take])
    objective = Counted(PaperObjective(task, Rotation.AS_GIVEN, PaperSettings(image_size=image_size)), budget)
    rng = np.random.default_rng(seed)
    try:
        while True:
            OPTIMISERS[optimiser](objective, rng)
    except BudgetSpentError:
        frame = Theta.from_vector(objective.vector).source_frame(SCANNER.source_to_cor_mm)
    checkpoints = np.unique(np.linspace(1, budget, CHECKPOINTS).astype(int))
    return {
        "best": [objective.best[at - 1] for at in checkpoints],
        "evaluations": checkpoints.tolist(),
        "ray_error_mm": ray_error(SCANNER, TRUE_FRAME, frame).rms_mm,
    }


def optimiser_units(plan: Plan, optimiser: str) -> list[Unit]:
    """List the runs of one optimiser."""
    settings = {
        "optimiser": optimiser,
        "budget": plan.optimiser_budget,
        "views": plan.sparse_views,
        "image_size": plan.study_image_size,
        "made_of": default_source(),
    }
    number = list(OPTIMISERS).index(optimiser)
    return [
        Unit(f"optimiser-{number}-{seed}", run, settings | {"seed": seed}, 3.0) for seed in range(plan.optimiser_seeds)
    ]


def _default(plan: Plan) -> Unit:
    """Return the unit of the product's calibration of the same scan."""
    return default_unit("l-shape", default_source(), plan.sparse_views, 0)


def units(plan: Plan) -> list[Unit]:
    """List all units."""
    return [_default(plan), *(unit for optimiser in OPTIMISERS for unit in optimiser_units(plan, optimiser))]


def _draw(runs: Mapping[str, list[Result]], best: float, path: Path) -> None:
    drawn = pictures.figure(8.0, 4.4)
    axes = drawn.subplots()
    for (name, made), (colour, line) in zip(runs.items(), STYLES, strict=True):
        deficit = 100.0 * (1.0 - np.array([run["best"] for run in made]) / best)
        low, middle, high = np.quantile(deficit, [0.25, 0.5, 0.75], axis=0)
        axes.plot(made[0]["evaluations"], middle, line, color=colour, lw=1.8, label=name)
        axes.fill_between(made[0]["evaluations"], low, high, color=colour, alpha=0.15, lw=0.0)
    axes.axhline(100.0 * SUCCESS, color=pictures.BLACK, lw=0.8)
    axes.set_yscale("log")
    axes.set_xlabel("evaluations of the objective")
    axes.set_ylabel("J worse than the best known, %")
    axes.legend(fontsize=9)
    pictures.save(drawn, path)


HEADER = (
    "optimiser",
    "successes",
    "best J, deficit: least",
    "median",
    "largest",
    "median ray error, mm",
    "largest",
)


def section(plan: Plan, results: Results, folder: Path) -> Values:
    """Return the share of success, the distribution of the best J, and its course."""
    runs = {name: [results[unit.name] for unit in optimiser_units(plan, name)] for name in OPTIMISERS}
    best = min(run["best"][-1] for made in runs.values() for run in made)
    _draw(runs, best, folder / "optimisers.png")
    rows, shares, medians, successful = [], {}, {}, []
    for name, made in runs.items():
        deficit = 1.0 - np.array([run["best"][-1] for run in made]) / best
        rays = np.array([run["ray_error_mm"] for run in made])
        good = deficit <= SUCCESS
        shares[name], medians[name] = f"{good.sum()} of {len(made)}", float(np.median(deficit))
        successful += rays[good].tolist()
        quantiles = [f"{value:.2%}" for value in np.quantile(deficit, [0.0, 0.5, 1.0])]
        rows.append([name, shares[name], *quantiles, f"{np.median(rays):.2f}", f"{rays.max():.2f}"])
    return {
        "budget": str(plan.optimiser_budget),
        "sparse": str(plan.sparse_views),
        "source": default_source(),
        "size": str(plan.study_image_size),
        "seeds": str(plan.optimiser_seeds),
        "success": f"{SUCCESS:.0%}",
        "best": f"{best:.0f}",
        "ranking": "; ".join(f"{name} {share}" for name, share in shares.items()),
        "winner": min(medians, key=lambda name: medians[name]),
        "table": pictures.table(HEADER, rows),
        "success_errors": f"{min(successful):.2f} to {max(successful):.2f} mm" if successful else "(there are none)",
        "default_error": f"{results[_default(plan).name]['ray_error_mm']:.3f}",
    }


EXPERIMENT = Experiment("optimisers", units, section)
