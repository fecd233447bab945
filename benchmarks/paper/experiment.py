"""Experiments: units of work whose results are kept, and the figures of a section of the page."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

# Numbers, strings and lists of them; arrays are kept next to them.
Result = dict[str, Any]
Results = Mapping[str, Result]
Values = dict[str, str]


@dataclass(frozen=True)
class Plan:
    """The size of everything: the defaults take about seven minutes on two idle cores, `FULL` takes hours.

    Attributes
    ----------
    in_odl : bool
        Runs the published pipeline in ODL as well.
    sparse_runs, dense_runs : int
        Runs of the `paper` method for the pair plots, from few views and from many.
    sparse_image_size, dense_image_size : int
        Side in pixels of the image that the `paper` method correlates, from few views and from many.
    study_image_size : int
        Side in pixels of that image where objectives and optimisers are compared.
    study_binned : int
        Detector cells averaged in that comparison, where sinograms are compared.
    dense_binned : int
        Detector cells averaged before the `paper` method sees many views.
    max_generations : int
        Generations of a `paper` search, which stops by itself long before.
    tight_generations : int
        Generations of a search that waits until its population agrees.
    compared_views : tuple of int
        Numbers of views at which calibrations and reconstruction methods are compared.
    log_image_size : int
        Side in pixels of a log's image where methods are compared; a power of two up to 256.
    """

    in_odl: bool = False
    sparse_runs: int = 20
    dense_runs: int = 20
    table_runs: int = 5
    noise_seeds: int = 20
    sparse_image_size: int = 128
    dense_image_size: int = 96
    study_image_size: int = 64
    study_binned: int = 4
    dense_binned: int = 2
    max_generations: int = 1000
    tight_generations: int = 100
    objective_runs: int = 6
    profile_points: int = 61
    optimiser_seeds: int = 12
    optimiser_budget: int = 3000
    dense_views: int = 360
    sparse_views: int = 20
    compared_views: tuple[int, ...] = (360, 180, 90, 45, 20)
    log_image_size: int = 256


# The published pipeline as well, and images and cells as many as the paper's.
FULL = Plan(in_odl=True, sparse_image_size=256, dense_image_size=256, dense_binned=1)


@dataclass(frozen=True)
class Unit:
    """A run that is done once; its result is kept under its name.

    Attributes
    ----------
    name : str
        A file's name. Two experiments may name the same unit.
    work : callable
        A function of a module, called with the settings in a separate process.
    seconds : float
        Seconds on an idle core, roughly; for the time left.
    """

    name: str
    work: Callable[..., Result]
    settings: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 1.0


@dataclass(frozen=True)
class Experiment:
    """A section of docs/evidence/paper.md.

    Attributes
    ----------
    name : str
        The results file is `benchmarks/results/paper-NAME.json`.
    units : callable
        Plan -> the units that it needs.
    section : callable
        (plan, results by unit name, folder for pictures) -> the section's figures; it draws its pictures.
    """

    name: str
    units: Callable[[Plan], list[Unit]]
    section: Callable[[Plan, Results, Path], Values]
