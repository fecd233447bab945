"""Does the units that are not done yet, in a pool of processes, and writes the figures of the page from all results."""

import multiprocessing
import os
import shutil
import tempfile
import textwrap
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path

import numba
from measurement import Measurement, keep_published, reference_s
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from scans import sources

from paper.experiment import Experiment, Plan, Result, Unit, Values
from paper.store import load, save

LINE = 120
# First characters of blocks that are no paragraphs: headings, tables, pictures, code.
KEPT = ("#", "|", "!", "```")


@dataclass(frozen=True)
class Places:
    """Folders: of the units' results, of the figures for the page, and of its pictures."""

    work: Path
    results: Path
    pictures: Path


def one_thread() -> None:
    """Limit a process of the pool to one thread: as many processes as cores are faster than more threads."""
    numba.set_num_threads(1)


def _execute(unit: Unit) -> Result:
    return unit.work(**unit.settings)


def distinct(experiments: Sequence[Experiment], plan: Plan) -> list[Unit]:
    """List all units, each once: experiments share some."""
    return list({unit.name: unit for experiment in experiments for unit in experiment.units(plan)}.values())


def work_through(units: Sequence[Unit], work: Path, *, processes: int) -> None:
    """Run the units that have no result, shortest first; a failed unit ends the command, earlier results stay."""
    waiting = sorted((unit for unit in units if load(work, unit) is None), key=lambda unit: unit.seconds)
    total = sum(unit.seconds for unit in waiting)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    spawn = multiprocessing.get_context("spawn")
    with (
        Progress(*columns, console=Console(stderr=True), speed_estimate_period=600.0) as progress,
        ProcessPoolExecutor(processes, mp_context=spawn, initializer=one_thread) as pool,
    ):
        task = progress.add_task(f"{len(units) - len(waiting)} of {len(units)} runs were done", total=total)
        try:
            _feed(pool, waiting, work, progress, task, processes)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _feed(
    pool: ProcessPoolExecutor, waiting: list[Unit], work: Path, progress: Progress, task: TaskID, processes: int
) -> None:
    left = list(waiting)
    running: dict[Future[Result], Unit] = {}
    while left or running:
        while left and len(running) < processes:
            unit = left.pop(0)
            running[pool.submit(_execute, unit)] = unit
        progress.update(task, description=", ".join(unit.name for unit in running.values()))
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            unit = running.pop(future)
            try:
                save(work, unit, future.result())
            except Exception as error:
                error.add_note(f"in {unit.name}")
                raise
            progress.advance(task, unit.seconds)


def gather(units: Sequence[Unit], work: Path) -> dict[str, Result]:
    """Collect the results by unit name.

    Raises
    ------
    LookupError
        A result is missing.
    """
    results = {unit.name: load(work, unit) for unit in units}
    missing = [name for name, result in results.items() if result is None]
    if missing:
        raise LookupError(f"{len(missing)} results are missing in {work}, the first is {missing[0]}: run the command")
    return {name: result for name, result in results.items() if result is not None}


def wrapped(text: str) -> str:
    """Break Markdown's paragraphs into lines of at most LINE characters; the rest stays as it is."""
    parts = text.split("\n\n")
    return "\n\n".join(
        part
        if part.lstrip("\n").startswith(KEPT)
        else textwrap.fill(part, LINE, break_long_words=False, break_on_hyphens=False)
        for part in parts
    )


def figures(experiments: Sequence[Experiment], plan: Plan, work: Path, pictures: Path) -> dict[str, Values]:
    """Compute the figures of each experiment, by the name of its results file, and draw its pictures."""
    return {
        f"paper-{experiment.name}": {
            key: wrapped(text) if "\n" in text else text
            for key, text in experiment.section(plan, gather(experiment.units(plan), work), pictures).items()
        }
        for experiment in experiments
    }


def conduct(
    experiments: Sequence[Experiment], plan: Plan, places: Places, reference: Callable[[], float] = reference_s
) -> None:
    """Run the experiments and write figures, none of which is a time, and pictures."""
    measurement = Measurement.begin(
        "worker/sawmill_tomography/calibration", "worker/sawmill_tomography/reconstruction", reference=reference
    )
    keep_published({f"paper-{experiment.name}": sources()[0] for experiment in experiments}, places.results)
    work_through(distinct(experiments, plan), places.work, processes=os.cpu_count() or 1)
    with tempfile.TemporaryDirectory() as drawn:
        values = figures(experiments, plan, places.work, Path(drawn))
        measurement.write(values, places.results, timed=False)
        shutil.copytree(drawn, places.pictures, dirs_exist_ok=True)
