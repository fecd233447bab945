"""Long jobs that are ended again and again, and go on where they were: on a real store, in this process."""

from collections.abc import Callable
from dataclasses import replace
from itertools import count
from types import SimpleNamespace
from typing import Any

import pytest

from sawmill_worker.contracts.calibrations import CalibrationAsk, PaperOptions
from sawmill_worker.contracts.jobs import JobKind
from sawmill_worker.jobs import keeping
from sawmill_worker.jobs.attempt import Attempt
from sawmill_worker.jobs.running import run
from sawmill_worker.vocabulary import CalibrationMethod

pytestmark = pytest.mark.slow

# Times, and what is told of them, are no part of an answer.
NOT_COMPARED = {"timing_s", "time_s"}


class Killed(Exception):  # noqa: N818 - what happened to it
    pass


@pytest.fixture
def hours_go_by(monkeypatch):
    """A second goes by whenever the clock is looked at: a checkpoint every few evaluations."""
    monkeypatch.setattr(keeping, "time", SimpleNamespace(monotonic=map(float, count()).__next__))


@pytest.fixture
def run_killed(store, tmp_path) -> Callable[..., tuple[dict[str, Any], int]]:
    """Run a job; each attempt dies when it has announced its progress so many times."""

    def killed(first: Attempt, announcements: int) -> tuple[dict[str, Any], int]:
        for number in range(1, 200):
            output = tmp_path / f"killed-{first.job.id}-{number}"
            output.mkdir()
            left = iter(range(announcements))

            def announce(names, output=output, left=left):
                store.files.keep(output, first.job.id, names)
                if next(left, None) is None:
                    raise Killed

            job = first.job.model_copy(update={"attempt": number})
            try:
                return run(replace(first, job=job, output=output, announce=announce)), number - 1
            except Killed:
                continue
        raise AssertionError("it made no progress")

    return killed


def same(one, other):
    assert {k: v for k, v in one.items() if k not in NOT_COMPARED} == {
        k: v for k, v in other.items() if k not in NOT_COMPARED
    }


@pytest.fixture
def search(store, ingested, sinogram, turn):
    """Ask for a published search of some 200 evaluations, its polish included."""
    scan = ingested(sinogram(turn(20))[:, None], "9:18")
    paper = PaperOptions(image_size=32, max_generations=1)

    def asked(**options: Any) -> None:
        wanted = CalibrationAsk(scan_id=scan.id, method=CalibrationMethod.PAPER, paper=paper, rows="0:1", **options)
        store.calibrations.accept(wanted)

    return asked


@pytest.mark.usefixtures("hours_go_by")
def test_a_published_search_killed_again_and_again_finds_the_same_theta(search, attempt, run_killed):
    search()
    job = attempt(JobKind.CALIBRATE)
    whole = run(job)
    result, deaths = run_killed(job, 4)
    assert deaths > 3
    same(result, whole)


def test_a_short_job_keeps_nothing(search, attempt, monkeypatch):
    monkeypatch.setattr(keeping, "time", SimpleNamespace(monotonic=lambda: 0.0))
    search()
    announced = []
    job = attempt(JobKind.CALIBRATE)
    run(replace(job, announce=announced.append))
    assert announced == []
    assert not job.checkpoints.exists()


@pytest.mark.usefixtures("hours_go_by")
@pytest.mark.parametrize("damage", ["truncated", "another scanner", "another version"])
def test_progress_that_does_not_fit_is_passed_over(search, store, attempt, spec, monkeypatch, damage):
    search()
    job = attempt(JobKind.CALIBRATE)

    def die(names):
        store.files.keep(job.output, job.job.id, names)
        raise Killed

    with pytest.raises(Killed):
        run(replace(job, announce=die))
    path = store.files.kept_with(job.job.id, "search")
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:-7])
    elif damage == "another version":
        monkeypatch.setattr(keeping, "version", lambda _: "0.0.1")
    else:
        constants = replace(store.scanners.get("line-2").constants, source_to_cor_mm=900.0)
        store.scanners.update("line-2", spec().model_copy(update={"constants": constants}))
    log = []
    monkeypatch.setattr(keeping.structlog, "get_logger", lambda: Log(log))
    run(replace(job, announce=lambda _: None))
    assert ("checkpoint-passed-over", "search") in log


class Log:
    def __init__(self, lines):
        self.lines = lines

    def bind(self, **_):
        return self

    def _note(self, event, *, name, **_):
        self.lines.append((event, name))

    info = warning = _note
