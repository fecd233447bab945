"""The faults, a function each: it disturbs a trial until there have been enough, and leaves everything as it was."""

import signal
import time
from collections.abc import Iterator

from tests.faults.processes import playing, send, serving
from tests.faults.product import LEASE_S
from tests.faults.trial import Trial

AIMED = 0.8  # share of the faults that look for a process with a job


def kill(trial: Trial) -> None:
    """Kill by SIGKILL: the API, a worker, an attempt, a template of attempts."""
    while trial.again(0.5, 4.0):
        part, victim = _victim(trial, ("api", "worker", "attempt", "attempt", "template"))
        send([victim], signal.SIGKILL)
        trial.happened[f"killed {part}"] += 1


def stop(trial: Trial) -> None:
    """Stop by SIGSTOP: a worker, or an attempt under a running worker, for twice the lease; an attempt for good."""
    while trial.again(0.5, 2.0):
        part, victim = _victim(trial, ("worker", "attempt"))
        send([victim], signal.SIGSTOP)
        if part == "attempt" and trial.rng.random() < 0.5:
            trial.happened["hung attempt"] += 1
            continue
        time.sleep(2 * LEASE_S)
        send([victim], signal.SIGCONT)
        trial.happened[f"stopped {part}"] += 1


def redis_trouble(trial: Trial) -> None:
    """Kill, pause and empty Redis, and once take it away for long."""
    server = trial.redis
    assert server is not None
    waits = {"killed": 0.5, "away": 600.0 if trial.long else 15.0}
    for what in _mixed(trial, ("killed", "paused", "flushed", "away"), once="away"):
        if what == "flushed":
            server.flush()
        elif what == "paused":
            with server.paused():
                time.sleep(2 * LEASE_S)
        else:
            server.kill()
            time.sleep(waits[what])
            server.start()
        trial.happened[f"redis {what}"] += 1


def postgres_trouble(trial: Trial) -> None:
    """Restart PostgreSQL in order, crash it, pause it for twice the lease, and once take it away."""
    server = trial.postgres
    assert server is not None
    away_s = 120.0 if trial.long else 10.0
    for what in _mixed(trial, ("restarted", "crashed", "paused", "away"), once="away"):
        if what == "paused":
            with server.paused():
                time.sleep(2 * LEASE_S)
        else:
            server.end(crash=what == "crashed")
            time.sleep(away_s if what == "away" else 0.0)
            server.start()
        trial.happened[f"postgresql {what}"] += 1


def _victim(trial: Trial, parts: tuple[str, ...]) -> tuple[str, int]:
    """Choose a part that runs and one of its processes, mostly one that has a job."""
    while True:
        part = trial.rng.choice(parts)
        processes, holders = playing(trial.product.world, part), trial.holders()
        if processes and trial.rng.random() < AIMED:
            aimed = [process_id for process_id in processes if process_id in holders]
            return part, serving(processes, holders) if part == "attempt" else (aimed or processes)[0]
        if processes:
            return part, trial.rng.choice(processes)
        time.sleep(0.1)


def _mixed(trial: Trial, kinds: tuple[str, ...], *, once: str) -> Iterator[str]:
    """Yield kinds in random order, again and again, one of them once."""
    left = list(kinds)
    while trial.again(1.0, 4.0):
        what = trial.rng.choice(left)
        if what == once:
            left.remove(once)
        yield what
