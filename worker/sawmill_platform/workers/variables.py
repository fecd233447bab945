"""Environment variables named like settings: an unknown one is refused, as an unknown field of a request is.

A variable whose value its setting does not accept is refused as well.
"""

import difflib
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from pydantic import ValidationError

from sawmill_platform.attempts.forking import REQUESTS, TBB
from sawmill_platform.attempts.protocol import CHANNEL
from sawmill_platform.contracts.base import complaint
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.settings import ExecutionSettings

PREFIX = "SAWMILL_"
# The API's settings: workers share its environment and do not import it; a test compares the two lists.
OF_THE_SERVICE = frozenset(
    {
        "SAWMILL_HOST",
        "SAWMILL_PORT",
        "SAWMILL_ALLOWED_HOSTS",
        "SAWMILL_TOKEN",
        "SAWMILL_TOKEN_FILE",
        "SAWMILL_PUBLIC_URL",
        "SAWMILL_MAX_ALL_WAITING_UPLOAD_BYTES",
        "SAWMILL_MAX_WAITING_UPLOADS",
        "SAWMILL_MAX_WAITING_UPLOAD_BYTES",
        "SAWMILL_MAX_WAITS_AT_ONCE",
        "SAWMILL_TRUSTED_PROXIES",
        "SAWMILL_MAX_UPLOAD_BYTES",
        "SAWMILL_DRAWING_MEMORY_BYTES",
        "SAWMILL_MAX_PICTURE_BYTES",
        "SAWMILL_MAX_JSON_BYTES",
        "SAWMILL_EVENT_POLL_S",
        "SAWMILL_RETRY_AFTER_S",
        "SAWMILL_MAX_CONNECTIONS",
        "SAWMILL_CLIENT_SILENCE_S",
        "SAWMILL_MIN_CLIENT_BYTES_PER_S",
        "SAWMILL_BODY_GRACE_S",
        "SAWMILL_RATE_LIMIT",
        "SAWMILL_CHANGE_RATE_LIMIT",
        "SAWMILL_FAILED_LOGIN_RATE_LIMIT",
        "SAWMILL_MAX_REQUESTS_AT_ONCE",
        "SAWMILL_MAX_BODIES_AT_ONCE",
        "SAWMILL_MAX_STREAMS",
        "SAWMILL_WEBHOOK_DESTINATIONS",
    }
)
NO_SETTINGS = frozenset({CHANNEL, REQUESTS, TBB, "SAWMILL_PUBLISHED_DATA"})
KNOWN = (
    frozenset(
        f"{PREFIX}{name.upper()}" for group in (StorageSettings, ExecutionSettings) for name in group.model_fields
    )
    | OF_THE_SERVICE
    | NO_SETTINGS
)


class WrongVariableError(Exception):
    """A variable of the environment that cannot be used; the sentence names it."""


class UnknownVariableError(WrongVariableError):
    """A variable named like a setting that does not exist."""


@contextmanager
def variables_checked() -> Iterator[None]:
    """Check the variables for the block in which settings are read.

    Raises
    ------
    WrongVariableError
        A variable is misspelt, or its setting refuses its value.
    """
    check_variables()
    try:
        yield
    except ValidationError as error:
        setting = "_".join(str(part) for part in error.errors()[0]["loc"]).upper()
        # A message about several settings together names them itself.
        raise WrongVariableError(f"{PREFIX}{setting}: {complaint(error)}" if setting else complaint(error)) from error


def check_variables(environment: Mapping[str, str] = os.environ) -> None:
    """Refuse a misspelt setting, which would otherwise leave the default in force without notice."""
    unknown = sorted(name for name in environment if name.upper().startswith(PREFIX) and name.upper() not in KNOWN)
    if unknown:
        raise UnknownVariableError(_sentence(unknown[0]))


def _sentence(name: str) -> str:
    rests = [known.removeprefix(PREFIX) for known in KNOWN]
    nearest = difflib.get_close_matches(name.upper().removeprefix(PREFIX), rests, n=1)
    right = (
        f"did you mean {PREFIX}{nearest[0]}?" if nearest else "unset it; docs/look-up/settings.md lists the settings"
    )
    return f"{name} is no setting: {right}"
