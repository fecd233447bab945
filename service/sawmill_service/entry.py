"""What the command `sawmill` runs: its command line, and an early Ctrl-C without a traceback."""

import os
import sys

INTERRUPTED = 130  # as shells say it of SIGINT


def main() -> None:
    """Import the command line, which takes a moment, and run it."""
    # Threads of GNU OpenMP that wait by keeping a core busy keep other processes from it, for minutes in all.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    try:
        from sawmill_service.cli import main as command_line  # noqa: PLC0415 - so that an interruption is caught here

        command_line()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
