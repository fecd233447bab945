"""Entry point of the command `sawmill`: the command line, and an early Ctrl-C without a traceback."""

import sys

INTERRUPTED = 130  # exit code of shells for SIGINT


def main() -> None:
    """Import the command line, which takes a moment, and run it."""
    try:
        from sawmill_platform.attempts.importing import importing  # noqa: PLC0415 - as the next
        from sawmill_platform.attempts.threading_layer import configure_threads  # noqa: PLC0415 - as the next

        configure_threads()
        with importing():
            # Imported here, so that an interruption is caught.
            from sawmill_command.commands import main as command_line  # noqa: PLC0415

        command_line()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
