"""The process of an attempt, apart from the science."""

import os

from sawmill_platform.attempts import attempt
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_worker.jobs import running


def test_an_attempt_whose_supervisor_was_killed_ends_without_a_word():
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "wb", buffering=0) as channel:  # noqa: PTH123 - a descriptor, not a path
        attempt._attempt(channel, running, ExecutionSettings())
