"""The real process of an attempt over tasks without science: its upload, phantom or scanner names what it does."""

import errno
import json
import mmap
import os
import resource
import signal
import stat
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from reaching import endings

from sawmill_contracts import kinds
from sawmill_contracts.handed_over import HandedOver
from sawmill_contracts.reconstructions import Reconstruction
from sawmill_formats.output.scan_layout import DATA
from sawmill_formats.output.scan_writer import new_scan
from sawmill_formats.output.volume_writer import new_reconstruction
from sawmill_platform.attempts.attempt import main
from sawmill_platform.attempts.protocol import Attempt, Needs, Succeeded, to_line
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.jobs import FailureKind, Job
from sawmill_platform.files.file_store import work_of
from sawmill_store.subjects.outputs import check_file
from sawmill_vocabulary import Progress

sys.path.append(str(Path(__file__).parents[2] / "support"))
import results
from results import make_endless

Behaviour = Callable[[Attempt], dict[str, Any]]
LIMITS = ("DATA", "CPU", "FSIZE", "NOFILE", "CORE")


def succeed(attempt: Attempt) -> dict[str, Any]:
    print("libraries print things")  # noqa: T201 - must not disturb the protocol
    attempt.report(Progress(fraction=0.5, stage="reading"))
    about = {"angles_rad": np.arange(20) * 0.1, "detector_pitch_mm": 1.5, "row_pitch_mm": None}
    with new_scan(attempt.output / "scan.h5", (20, 1, 768), **about) as written:
        written.data[...] = 0.0
        written.note(air_level=None, provenance={})
    return results.reading(remarks=[f"attempt {attempt.job.attempt}, process {os.getpid()}"])


def wait_for_leave(attempt: Attempt) -> dict[str, Any]:
    (attempt.output / "waiting").touch()
    while not (attempt.output.parents[1] / "leave").exists():
        time.sleep(0.05)
    (attempt.output / "waiting").unlink()
    return succeed(attempt)


def failing(detail: str) -> Behaviour:
    def behaviour(_: Attempt) -> dict[str, Any]:
        raise JobFailure(FailureKind.INPUT, "angles-missing", detail)

    return behaviour


def stumble(attempt: Attempt) -> dict[str, Any]:
    if attempt.job.attempt == 1:
        raise JobFailure(FailureKind.PASSING, "busy", "something was busy")
    return succeed(attempt)


def work_on_and_die(attempt: Attempt) -> dict[str, Any]:
    """One step further than the last attempt that was killed, until five are done."""
    kept = attempt.given.kept / "steps"
    done = int(kept.read_text()) if kept.exists() else 0
    if done == 5:
        return succeed(attempt)
    attempt.checkpoints.mkdir()
    (attempt.checkpoints / "steps").write_text(str(done + 1))
    attempt.announce(["steps"])
    os.kill(os.getpid(), signal.SIGKILL)
    return {}


def keep_and_succeed(attempt: Attempt) -> dict[str, Any]:
    attempt.checkpoints.mkdir()
    for number in range(50):
        (attempt.checkpoints / f"steps-{number}").write_text("many")
        attempt.announce([f"steps-{number}"])
    (attempt.checkpoints / "unannounced").write_text("half")
    return succeed(attempt)


def write_a_volume(attempt: Attempt) -> dict[str, Any]:
    size = Reconstruction.model_validate_json(attempt.given.asked_json or "").options.size
    shape, about = (1, size, size), {"software_version": "0", "input_sha256": ""}
    made = {"pixel_mm": 1.0, "row_pitch_mm": None, "unit": "1/mm", "geometry": {}, "parameters": {}}
    with new_reconstruction(attempt.output / "volume.h5", shape, **made, **about) as volume:
        volume.write(0, np.random.default_rng(1).random(shape, np.float32))
    return results.reconstruction_result(shape=shape)


def leave_more(attempt: Attempt) -> dict[str, Any]:
    (attempt.output / "more").touch()
    return succeed(attempt)


def name_the_database(attempt: Attempt) -> dict[str, Any]:
    """As the place of the line integrals."""
    reported = succeed(attempt)
    with h5py.File(attempt.output / "scan.h5", "r+") as file:
        del file[DATA]
        database = str(attempt.output.parents[1] / "sawmill.db")
        file.create_dataset(DATA, (20, 1, 768), "f4", external=[(database, 0, 4 * 20 * 768)])
    return reported


def leave_an_endless_file(attempt: Attempt) -> dict[str, Any]:
    """As after somebody took the process over: the library never gets to the end of it."""
    reported = succeed(attempt)
    make_endless(attempt.output / "scan.h5")
    return reported


def fill_the_disk(_: Attempt) -> dict[str, Any]:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def miss_its_folder(attempt: Attempt) -> dict[str, Any]:
    """At its first attempt, as while a mount is away for a moment."""
    return _missing(attempt.output / "scan.h5") if attempt.job.attempt == 1 else succeed(attempt)


def miss_its_file(attempt: Attempt) -> dict[str, Any]:
    """The same while it reads, as a reader reports it."""
    if attempt.job.attempt > 1:
        return succeed(attempt)
    try:
        return _missing(attempt.given.file)
    except FileNotFoundError as error:
        raise JobFailure(FailureKind.INPUT, "broken-file", "this file is damaged") from error


def _missing(path: Path) -> dict[str, Any]:
    raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))


def end_by(number: signal.Signals) -> Behaviour:
    def behaviour(attempt: Attempt) -> dict[str, Any]:
        (attempt.output / "half").write_text("written")
        os.kill(os.getpid(), number)
        return {}

    return behaviour


def burn(_: Attempt) -> dict[str, Any]:
    used = resource.getrusage(resource.RUSAGE_SELF)
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (int(used.ru_utime + used.ru_stime) + 1, hard))
    while True:
        pass


def write_much(attempt: Attempt) -> dict[str, Any]:
    with (attempt.output / "scan.h5").open("wb") as file:
        file.truncate(2**43)
    return {}


def share_memory(attempt: Attempt) -> dict[str, Any]:
    with mmap.mmap(-1, 5 * 2**27) as shared:
        for _ in range(5):
            shared.write(bytes(2**27))
        return succeed(attempt)


def start_a_thread(_: Attempt) -> dict[str, Any]:
    threading.stack_size(2**30)
    threading.Thread(target=print).start()
    return {}


def tell_limits(attempt: Attempt) -> dict[str, Any]:
    limits = {name: resource.getrlimit(getattr(resource, f"RLIMIT_{name}")) for name in LIMITS}
    return succeed(attempt) | {"remarks": [json.dumps(limits)]}


def tell_all(attempt: Attempt) -> dict[str, Any]:
    """Limits, surroundings, and how far it can reach, in the sentence of a refusal."""
    status = Path("/proc/self/status").read_text().splitlines()
    with tempfile.NamedTemporaryFile() as scratch:
        reported = {
            "limits": {name: resource.getrlimit(getattr(resource, f"RLIMIT_{name}"))[0] for name in LIMITS},
            "capabilities": [line for line in status if line.startswith(("CapEff", "CapPrm", "CapAmb"))],
            "folder": str(Path.cwd()),
            "in folder": [path.name for path in Path().iterdir() if path.name != Path(scratch.name).name],
            "scratch": scratch.name,
            "home": str(Path.home()),
            "environment": [*os.environ.values(), Path("/proc/self/environ").read_text()],
            "open": [str(Path(f"/proc/self/fd/{number}").readlink()) for number in range(3, scratch.fileno())],
            "tries": endings(attempt.output),
        }
    raise JobFailure(FailureKind.INPUT, "reported", json.dumps(reported))


def write_process_id(attempt: Attempt) -> None:
    begun = attempt.output / "pid.part"
    begun.write_text(str(os.getpid()))
    begun.rename(attempt.output / "pid")


def talk(attempt: Attempt) -> dict[str, Any]:
    write_process_id(attempt)
    for step in range(6000):
        attempt.report(Progress(fraction=step / 6000, stage="search", generation=step))
        time.sleep(0.1)
    return {}


def hang(_: Attempt) -> dict[str, Any]:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    time.sleep(600)
    return {}


def loop(_: Attempt) -> dict[str, Any]:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    while True:
        pass


def hang_once(attempt: Attempt) -> dict[str, Any]:
    if attempt.job.attempt == 1:
        attempt.report(Progress(fraction=0.5, stage="prepare"))
        return hang(attempt)
    return succeed(attempt)


def repeat(attempt: Attempt) -> dict[str, Any]:
    for second in range(6000):
        attempt.report(Progress(fraction=0.5, stage="search", seconds_left=6000 - second))
        time.sleep(0.1)
    return {}


def freeze(attempt: Attempt) -> dict[str, Any]:
    write_process_id(attempt)
    os.kill(os.getpid(), signal.SIGSTOP)
    return {}


def creep(attempt: Attempt) -> dict[str, Any]:
    for step in range(20):
        attempt.report(Progress(fraction=step / 1e6, stage="search"))
        time.sleep(0.2)
    return succeed(attempt)


def pause(attempt: Attempt) -> dict[str, Any]:
    time.sleep(0.3)
    return succeed(attempt)


def write_to_worker(data: bytes) -> None:
    """Past the protocol: into whatever pipe there is."""
    for number in range(3, 64):
        try:
            if stat.S_ISFIFO(os.fstat(number).st_mode):
                os.write(number, data)
        except OSError:
            continue


def answer_and_stay(attempt: Attempt) -> dict[str, Any]:
    result = succeed(attempt)
    work_of(attempt.output).rmdir()
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    write_to_worker(to_line(Succeeded(result=result)))
    return hang(attempt)


def writing(pieces: Iterable[bytes]) -> Behaviour:
    def behaviour(attempt: Attempt) -> dict[str, Any]:
        for piece in pieces:
            write_to_worker(piece)
        return hang(attempt)

    return behaviour


def keep_behind_a_file(attempt: Attempt) -> dict[str, Any]:
    attempt.checkpoints.touch()
    attempt.announce(["steps"])
    return succeed(attempt)


def keep_a_folder(attempt: Attempt) -> dict[str, Any]:
    (attempt.checkpoints / "steps").mkdir(parents=True)
    attempt.announce(["steps"])
    return hang(attempt)


SIGNALS = (signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT, signal.SIGKILL)
# By their names with hyphens: what takes an attempt and gives an answer.
BEHAVIOURS: dict[str, Behaviour] = {
    "refuse": failing("the file carries no angles: give angles_deg"),
    "quote-a-nul": failing("the dataset 'data\0' has no angles"),
    "say-too-much": failing("the file carries no angles" * 2**12),
    "blunder": lambda _: {}["secret"],
    "answer-nonsense": lambda _: {"format": "NPZ", "surprise": 1},
    "eat-memory": lambda _: {"much": bytearray(2**30)},
    "open-many": lambda _: {"files": [os.open(os.devnull, os.O_RDONLY) for _ in range(500)]},
    "miss-something-else": lambda _: _missing(Path("/mill/of/somebody/else")),
    "name-a-file-outside": writing([b'{"kind":"kept","names":["../../../sawmill.db"]}\n']),
    "break-off": writing([b'{"kind":"kept","names":\n']),
    "never-end-its-line": writing(b" " * 2**20 for _ in range(1000)),
    "crash-on-a-full-disk": end_by(signal.SIGSEGV),  # as the HDF5 library does
    **{f"end-by-{number.name.lower()}": end_by(number) for number in SIGNALS},
} | {
    name.replace("_", "-"): each
    for name, each in list(globals().items())
    if list(getattr(each, "__annotations__", {}).values()) == [Attempt, dict[str, Any]]
}


def first_word(file: Path) -> str:
    """What the file asks for; a large one has a hole behind it."""
    with file.open("rb") as beginning:
        return beginning.read(64).rstrip(b"\0").decode(errors="replace")


def needs_of(_: Attempt) -> Needs:
    return Needs(0, 0)


def check(attempt: Attempt, answer: dict[str, Any]) -> None:
    kind, given = attempt.job.kind, attempt.given
    check_file(kind, given, results.answer_of(kind, answer), given.file)


def run(attempt: Attempt) -> dict[str, Any]:
    given = attempt.given
    of_files = {kinds.INGEST, kinds.INSPECT, kinds.TRACE_PHANTOM, kinds.CALIBRATE_PAIRS, kinds.LOCATE_MARKS}
    if attempt.job.kind in of_files:
        *_, asked_for = map(first_word, given.readable)
        return BEHAVIOURS[asked_for](attempt)
    named = (each.name for each in (given.phantom, given.scanner) if each is not None and each.name in BEHAVIOURS)
    unnamed = "write-a-volume" if attempt.job.kind is kinds.RECONSTRUCT else "refuse"
    return BEHAVIOURS[next(named, unnamed)](attempt)


def attempt(job: Job, given_json: str, output: Path, report: Any, announce: Any) -> Attempt[HandedOver]:
    return Attempt(job, HandedOver.model_validate_json(given_json), output, report, announce)


def warm_up() -> None:
    """No test waits for kernels to compile."""


def make_ready(_: Attempt) -> None:
    """Nothing is compiled."""


if __name__ == "__main__":
    main(sys.modules[__name__])
