"""The example resources, made in a process of their own: the service need not hold the science that they take."""

import subprocess
from pathlib import Path

import structlog

from sawmill_platform.attempts.environment import environment_with
from sawmill_platform.attempts.importing import PROGRAM
from sawmill_platform.files.file_store import EXAMPLES
from sawmill_store.store import Store

COMMAND = (*PROGRAM, "sawmill_command.examples")


def examples_made(store: Store) -> Path:
    """The file that says that a data folder has its examples."""
    return store.files.folder / EXAMPLES / "complete"


def seed_apart(store: Store) -> None:
    """Fill a data folder with examples once in its life; if this process ends before, the next start tries again."""
    if examples_made(store).exists():
        return
    # Its standard input ends with this process, and it with that.
    with subprocess.Popen(  # noqa: S603 - our own command
        COMMAND, stdin=subprocess.PIPE, stdout=2, start_new_session=True, env=environment_with(store.settings)
    ) as process:
        code = process.wait()
    if code:
        structlog.get_logger().error("examples-failed", exit_code=code)
