"""Creation of the example resources in a separate process, so that the service need not load the science."""

import subprocess
from pathlib import Path

import structlog

from sawmill_platform.attempts.environment import environment_with
from sawmill_platform.attempts.importing import PROGRAM
from sawmill_platform.files.file_store import EXAMPLES
from sawmill_store.mill_files import MillFiles
from sawmill_store.store import Store

COMMAND = (*PROGRAM, "sawmill_command.examples")


def examples_made(files: MillFiles) -> Path:
    """Return the path of the file that marks a data folder whose examples are made."""
    return files.folder / EXAMPLES / "complete"


def seed_apart(store: Store) -> None:
    """Fill a data folder with examples once in its life; if this process ends earlier, the next start tries again."""
    if examples_made(store.files).exists():
        return
    # The standard input of the new process ends with this process, and the new process ends with its standard input.
    with subprocess.Popen(  # noqa: S603 - our own command
        COMMAND, stdin=subprocess.PIPE, stdout=2, start_new_session=True, env=environment_with(store.settings)
    ) as process:
        code = process.wait()
    if code:
        structlog.get_logger().error("examples-failed", exit_code=code)
