"""Does the units that are not done yet, in a pool of processes, and writes the page from all results."""

import multiprocessing
import os
import textwrap
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from string import Template

import numba
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from paper.experiment import Experiment, Plan, Result, Unit, Values
from paper.store import load, save

TEMPLATES = Path(__file__).with_name("templates")
LINE = 120
# What a paragraph begins with that is none: headings, tables, pictures, code.
KEPT = ("#", "|", "!", "```")


@dataclass(frozen=True)
class Places:
    """Where results are kept, and where the page and its pictures go."""

    work: Path
    page: Path

    @property
    def pictures(self) -> Path:
        """The folder beside the page that its links name."""
        return self.page.parent / "paper"


def one_thread() -> None:
    """Each process of the pool computes with one thread: as many processes as cores are faster than more threads."""
    numba.set_num_threads(1)


def _execute(unit: Unit) -> Result:
    return unit.work(**unit.settings)


def distinct(experiments: Sequence[Experiment], plan: Plan) -> list[Unit]:
    """All units, each once: experiments share some."""
    return list({unit.name: unit for experiment in experiments for unit in experiment.units(plan)}.values())


def work_through(units: Sequence[Unit], work: Path, *, processes: int) -> None:
    """Do what is not done, shortest first; a failed unit ends the command, and what is done stays done."""
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
    """The results by unit name.

    Raises
    ------
    LookupError
        If one is missing.
    """
    results = {unit.name: load(work, unit) for unit in units}
    missing = [name for name, result in results.items() if result is None]
    if missing:
        raise LookupError(f"{len(missing)} results are missing in {work}, the first is {missing[0]}: run the command")
    return {name: result for name, result in results.items() if result is not None}


def _filled(template: str, values: Values) -> str:
    return Template((TEMPLATES / f"{template}.md").read_text()).substitute(values)


def wrapped(text: str) -> str:
    """Markdown with its paragraphs broken into lines of at most LINE characters; the rest stays as it is."""
    parts = text.split("\n\n")
    return "\n\n".join(
        part
        if part.lstrip("\n").startswith(KEPT)
        else textwrap.fill(part, LINE, break_long_words=False, break_on_hyphens=False)
        for part in parts
    )


def write_page(experiments: Sequence[Experiment], plan: Plan, places: Places) -> None:
    """The page and its pictures, from the results alone; an experiment whose results are missing is left out."""
    sections = []
    for experiment in experiments:
        try:
            results = gather(experiment.units(plan), places.work)
        except LookupError as error:
            Console(stderr=True).print(f"{experiment.name} is left out: {error}")
            continue
        text = _filled(experiment.name, experiment.section(plan, results, places.pictures))
        command = f"Made by `make paper OPTIONS='--only {experiment.name}'`."
        sections.append(f"## {experiment.title}\n\n{command}\n\n{text}")
    places.page.parent.mkdir(parents=True, exist_ok=True)
    page = _filled("page", {"sections": "\n".join(sections)})
    places.page.write_text(wrapped(page).rstrip("\n") + "\n")


def conduct(experiments: Sequence[Experiment], wanted: Sequence[str], plan: Plan, places: Places) -> None:
    """Do the wanted experiments, then write the page of all whose results are there."""
    chosen = [experiment for experiment in experiments if experiment.name in wanted]
    work_through(distinct(chosen, plan), places.work, processes=os.cpu_count() or 1)
    write_page(experiments, plan, places)
