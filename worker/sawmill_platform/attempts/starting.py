"""Choice of the way in which the processes of attempts start, and their environment."""

import os
from collections.abc import Sequence
from pathlib import Path

from sawmill_platform.attempts.environment import environment_of_attempts
from sawmill_platform.attempts.process import AttemptStarter, FreshProcesses
from sawmill_platform.attempts.template import Template, template_library
from sawmill_platform.attempts.threading_layer import configure_threads
from sawmill_platform.job_service_store import JobServiceStore
from sawmill_platform.workers import sharing
from sawmill_platform.workers.settings import ExecutionSettings


def attempt_starter(command: Sequence[str], store: JobServiceStore, settings: ExecutionSettings) -> AttemptStarter:
    """Return the starter of attempts, which forks them if the settings and the system allow that.

    Parameters
    ----------
    command
        Command of a program that speaks `sawmill_platform.attempts.protocol`.
    store, settings
        Store of the jobs, and settings of their execution.
    """
    environment = attempt_environment(store, settings)
    library = template_library() if settings.fork_attempts else None
    return FreshProcesses(command, environment) if library is None else Template(command, environment, library)


def attempt_environment(store: JobServiceStore, settings: ExecutionSettings) -> dict[str, str]:
    """Return the environment variables of the processes of attempts."""
    environment = environment_of_attempts(settings)
    # Compiled kernels are kept with the installation; a read-only installation has no place for them and would raise.
    if not os.access(Path(__file__).parent, os.W_OK):
        environment.setdefault("NUMBA_CACHE_DIR", str(store.files.folder / "numba-cache"))
    configure_threads(environment)
    environment[sharing.VARIABLE] = str(sharing.threads_each(settings))
    return environment
