"""The process of an attempt, apart from the science."""

import os
import subprocess
import sys
from pathlib import Path

from sawmill_platform.attempts.protocol import CHANNEL

FAKE_SCIENCE = Path(__file__).with_name("fake_science.py")


def test_an_attempt_whose_supervisor_was_killed_ends_without_a_word():
    reading, writing = os.pipe()
    os.close(reading)
    ended = subprocess.run(
        [sys.executable, str(FAKE_SCIENCE)],
        env={**os.environ, CHANNEL: str(writing)},
        pass_fds=[writing],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    os.close(writing)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
