"""Workers that run at once share the cores."""

import pytest
from structlog.testing import capture_logs

from sawmill_platform.attempts.limits import cores
from sawmill_platform.workers import program
from sawmill_platform.workers.program import attempt_environment
from sawmill_platform.workers.settings import ExecutionSettings


def asked(workers, threads=None):
    return ExecutionSettings(workers=workers, numba_num_threads=threads, broker_url=None)


@pytest.mark.parametrize(("workers", "threads"), [(1, 8), (2, 4), (3, 2), (8, 1), (20, 1)])
def test_each_worker_has_its_share_of_the_cores(workers, threads):
    assert program.threads_each(asked(workers), {}, on_cores=8) == threads
    assert workers * threads <= max(8, workers)


def test_what_somebody_asked_for_is_kept():
    assert program.threads_each(asked(4, 6), {"NUMBA_NUM_THREADS": "3"}, on_cores=8) == 6
    assert program.threads_each(asked(4), {"NUMBA_NUM_THREADS": "3"}, on_cores=8) == 3


@pytest.mark.parametrize(
    ("workers", "threads", "said"),
    [
        (1, None, []),
        (4, None, []),
        (4, 2, []),
        (4, 3, ["more-threads-than-cores"]),
        (9, None, ["more-workers-than-cores"]),
    ],
)
def test_more_threads_than_cores_are_said(monkeypatch, workers, threads, said):
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    with capture_logs() as log:
        program.say_if_crowded(asked(workers, threads), on_cores=8)
    assert [entry["event"] for entry in log] == said


def test_attempts_get_their_share_for_kernels_and_one_thread_for_linear_algebra(store, monkeypatch):
    for name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    environment = attempt_environment(store, asked(2))
    share = str(max(1, cores() // 2))
    assert [environment[name] for name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS")] == [share, "1"]
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    assert attempt_environment(store, asked(2))["OPENBLAS_NUM_THREADS"] == "3"
