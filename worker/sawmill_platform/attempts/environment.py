"""Settings passed to a child process in environment variables."""

import json
import os
import re
from collections.abc import Iterable

from pydantic_settings import BaseSettings

from sawmill_platform.workers.settings import ExecutionSettings

SECRETS = frozenset({"SAWMILL_TOKEN", "SAWMILL_TOKEN_FILE"})
# Variables that Python, the numerical libraries and the logs read; any other variable may contain a password.
FOR_ATTEMPTS = re.compile(
    r"PATH|HOME|LANG|LANGUAGE|TZ|TERM|COLUMNS|NO_COLOR|FORCE_COLOR|TMPDIR|GLIBC_TUNABLES|VIRTUAL_ENV"
    r"|(LC|LD|MALLOC|NUMBA|TBB|OMP|GOMP|KMP|OPENBLAS|MKL|HDF5)_\w+|PYTHON\w+"
)


def environment_with(*settings: BaseSettings) -> dict[str, str]:
    """Return this process's environment with these settings as variables; the variables of null settings are unset.

    The service's token is not passed on: the children read strangers' files and need no token.
    """
    return _with_settings({name: value for name, value in os.environ.items() if name.upper() not in SECRETS}, settings)


def environment_of_attempts(settings: ExecutionSettings) -> dict[str, str]:
    """Return the variables that processes of attempts need, with the settings and without a secret."""
    needed = {name: value for name, value in os.environ.items() if FOR_ATTEMPTS.fullmatch(name)}
    return _with_settings(needed, [settings.model_copy(update={"broker_url": None})])


def _with_settings(environment: dict[str, str], settings: Iterable[BaseSettings]) -> dict[str, str]:
    for group in settings:
        prefix = group.model_config.get("env_prefix", "")
        for name, value in group.model_dump(mode="json").items():
            variable = f"{prefix}{name}".upper()
            if value is None:
                environment.pop(variable, None)
            else:
                environment[variable] = json.dumps(value) if isinstance(value, list) else str(value)
    return environment
