"""The real process of an attempt over tasks without science: what it does stands in the uploaded file."""

import errno
import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from worker.contracts.jobs import FailureKind, Job, JobKind, Progress
from worker.storage.store import Store


class JobFailure(Exception):  # noqa: N818 - the name of the real one
    def __init__(self, kind: FailureKind, code: str, detail: str) -> None:
        super().__init__(detail)
        self.kind, self.code, self.detail = kind, code, detail


@dataclass(frozen=True)
class Attempt:
    job: Job
    store: Store
    output: Path
    report: Callable[[Progress], None]


def succeed(attempt: Attempt) -> dict[str, Any]:
    print("libraries print things")  # noqa: T201 - must not disturb the protocol
    attempt.report(Progress(fraction=0.5, stage="reading"))
    (attempt.output / "scan.h5").write_text(f"attempt {attempt.job.attempt}, process {os.getpid()}")
    shape = {"views": 20, "rows": 1, "detector": 768}
    return {"format": "NPZ", "shape": shape, "angular_range_deg": (0.0, 342.0)}


def refuse(_: Attempt) -> dict[str, Any]:
    raise JobFailure(FailureKind.INPUT, "angles-missing", "the file carries no angles: give angles_deg")


def stumble(attempt: Attempt) -> dict[str, Any]:
    if attempt.job.attempt == 1:
        raise JobFailure(FailureKind.PASSING, "busy", "something was busy")
    return succeed(attempt)


def outlast(attempt: Attempt) -> dict[str, Any]:
    """Talk until four workers have been stopped, then stumble once."""
    if attempt.job.attempt <= 4:
        return talk(attempt)
    if attempt.job.attempt == 5:
        raise JobFailure(FailureKind.PASSING, "busy", "something was busy")
    return succeed(attempt)


def blunder(_: Attempt) -> dict[str, Any]:
    return {}["secret"]


def fill_the_disk(_: Attempt) -> dict[str, Any]:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def eat_memory(_: Attempt) -> dict[str, Any]:
    return {"much": bytearray(2**30)}


def crash(attempt: Attempt) -> dict[str, Any]:
    (attempt.output / "half").write_text("written")
    os.kill(os.getpid(), signal.SIGKILL)
    return {}


def crash_on_a_full_disk(_: Attempt) -> dict[str, Any]:
    """As the HDF5 library does."""
    os.kill(os.getpid(), signal.SIGSEGV)
    return {}


def talk(attempt: Attempt) -> dict[str, Any]:
    """For a minute."""
    (attempt.output / "pid").write_text(str(os.getpid()))
    for step in range(600):
        attempt.report(Progress(fraction=step / 600, stage="search", generation=step))
        time.sleep(0.1)
    return {}


def hang(_: Attempt) -> dict[str, Any]:
    """Without a word, and deaf to SIGTERM."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    time.sleep(60)
    return {}


def pause(attempt: Attempt) -> dict[str, Any]:
    time.sleep(0.7)
    return succeed(attempt)


def answer_nonsense(_: Attempt) -> dict[str, Any]:
    return {"format": "NPZ", "surprise": 1}


BEHAVIOURS = {
    behaviour.__name__.replace("_", "-"): behaviour
    for behaviour in (
        succeed,
        refuse,
        stumble,
        outlast,
        blunder,
        crash_on_a_full_disk,
        fill_the_disk,
        eat_memory,
        crash,
        talk,
        hang,
        pause,
        answer_nonsense,
    )
}


def run(attempt: Attempt) -> dict[str, Any]:
    if attempt.job.kind is not JobKind.INGEST:
        return refuse(attempt)
    upload = attempt.store.files.upload(JobKind.INGEST, attempt.job.subject_id)
    return BEHAVIOURS[upload.read_text()](attempt)


def install() -> None:
    """Put the fakes where the real process imports the science: no test waits for kernels to compile."""
    fakes: dict[str, dict[str, Any]] = {
        "worker.tasks": {},
        "worker.tasks.running": {"Attempt": Attempt, "run": run, "warm_up": lambda: None},
        "worker.tasks.failures": {"JobFailure": JobFailure},
    }
    for name, contents in fakes.items():
        module = ModuleType(name)
        vars(module).update(contents)
        sys.modules[name] = module


if __name__ == "__main__":
    install()
    from worker.execution.attempt import main

    main()
