"""Entry point of the command `sawmill`: the command line, and an early Ctrl-C without a traceback."""

import sys

INTERRUPTED = 130  # exit code of shells for SIGINT
# Extras of the package that bring a module; every other module that may be missing belongs to `service`.
EXTRAS = {"celery": "celery", "kombu": "celery", "redis": "celery", "psycopg": "postgresql"}


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
    except ModuleNotFoundError as error:
        module = (error.name or "sawmill").partition(".")[0]
        if module.startswith("sawmill"):
            raise
        extra = EXTRAS.get(module, "service")
        sys.exit(f"This needs {module}, which is not installed: pip install 'sawmill-calibration[{extra}]'")
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
