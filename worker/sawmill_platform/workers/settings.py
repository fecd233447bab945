"""Settings of the execution of jobs and rules of retries, for processes that open no database as well.

An environment variable that is named like a setting and is none is refused, as an unknown field of a request is.
"""

import difflib
import os
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from sawmill_platform.attempts.forking import REQUESTS, TBB
from sawmill_platform.attempts.protocol import CHANNEL
from sawmill_platform.contracts.base import complaint
from sawmill_platform.settings import StorageSettings

LONGEST_WAIT_S = 60.0


@dataclass(frozen=True)
class Retries:
    """Waits before retries after passing failures. Waits double from one to the next, up to a minute."""

    max_losses: int = 3
    loss_wait_s: float = 1.0
    outage_wait_s: float = 5.0


Seconds = Annotated[float, Field(gt=0, le=86_400)]
Wait = Annotated[float, Field(ge=0, le=LONGEST_WAIT_S)]


class WorkerSettings(BaseSettings):
    """Workers."""

    workers: Annotated[int, Field(ge=1, le=64)] = Field(
        1, description="Embedded worker processes, or jobs at once of a Celery worker; they share the cores."
    )
    broker_url: str | None = Field(
        None, description="Redis that carries wake-ups to Celery workers; null: embedded workers, no broker."
    )
    numba_num_threads: Annotated[int, Field(ge=1, le=1024)] | None = Field(
        None, description="Threads of one job; null: the cores, shared out among the workers, at least one each."
    )
    poll_s: Seconds = Field(
        0.2, description="How often an idle embedded worker looks for a job of which it got no wake-up."
    )
    sweep_s: Seconds = Field(
        5.0,
        description="Age in seconds at which a queued job's wake-up counts as lost and is sent again (cluster only).",
    )
    fork_attempts: bool = Field(
        default=True,
        description="Fork attempts from a process that has imported everything, where TBB is installed and the system "
        "allows it; otherwise each starts afresh, which costs a second or more of processor time.",
    )
    spare_processes: Annotated[int, Field(ge=1, le=8)] = Field(
        1, description="Processes kept ready with the science imported; more where jobs often come together."
    )
    spare_idle_s: Seconds = Field(
        600.0,
        description="How long an embedded worker keeps its template and its spare processes, which hold the science, "
        "without a job; the next job then waits a second or two for new ones.",
    )
    start_timeout_s: Seconds = Field(
        120.0,
        description="For a template or a fresh process that uses no processor time before it has imported the science; "
        "the first import compiles, which may take minutes, and is not ended for that.",
    )

    @field_validator("broker_url")
    @classmethod
    def _can_be_read(cls, url: str | None) -> str | None:
        """Refuse an address that is cut in the wrong place, as by a password with # or [; it is not printed."""
        try:
            parts = urlsplit(url or "redis://")
            whole = bool(parts.scheme) and not parts.fragment and parts.port != 0
        except ValueError:
            whole = False
        if not whole:
            raise ValueError(
                "it cannot be read as an address, such as redis://:PASSWORD@HOST:6379/0: in the user and the password "
                "write # as %23, / as %2F, ? as %3F, @ as %40, [ as %5B and ] as %5D"
            )
        return url


class JobLimitSettings(BaseSettings):
    """Limits of a job."""

    memory_limit_bytes: Annotated[int, Field(ge=2**28)] | None = Field(
        None,
        description="Private memory of one attempt; null: 2 GiB, or what the recorded sizes of its input need if that "
        "is more, and 64 MiB on top for each core beyond eight.",
    )
    time_limit_s: Annotated[float, Field(gt=0, le=30 * 86_400)] | None = Field(
        None,
        description="How long one attempt may take before the job fails; null: by its kind, 6 hours for reading an "
        "upload and 24 hours for everything else.",
    )
    stall_s: Seconds | None = Field(
        None,
        description="How long an attempt's progress may stand still before its process is ended, which is a loss; "
        "null: by the job's kind, as a rule 30 minutes.",
    )
    confine_attempts: bool = Field(
        default=True,
        description="Keep the process of each attempt to its own files and off the network, where the kernel has "
        "Landlock.",
    )


class LossSettings(BaseSettings):
    """Lost attempts and stops."""

    lease_s: Seconds = Field(60.0, description="How long a job stays with a worker that sends no heartbeat.")
    heartbeat_s: Seconds = Field(
        10.0, description="How often a worker renews its lease and looks for a cancellation; several times a lease."
    )
    max_attempts: Annotated[int, Field(ge=1, le=10)] = Field(
        3,
        description="Lost attempts at a job before it fails: a killed process, a worker without heartbeats. "
        "A clean stop, a full disk and an absent database are no loss.",
    )
    loss_wait_s: Wait = Field(
        1.0, description="Wait after a lost attempt; twice as long after the second, and so on up to 60 s."
    )
    outage_wait_s: Wait = Field(
        5.0, description="As `loss_wait_s`, while the disk is full or the database does not answer, however often."
    )
    stop_grace_s: Seconds = Field(
        5.0, description="How long a stopping worker waits for its job before it gives it back; below Docker's 10 s."
    )
    kill_grace_s: Seconds = Field(2.0, description="Between asking an attempt's process to end and killing it.")


class RecordSettings(BaseSettings):
    """Progress, housekeeping and log."""

    log_format: Literal["console", "json"] = Field("console", description="For people, or one JSON object a line.")
    progress_s: Seconds = Field(
        0.5, description="Progress is stored at most that often: each time costs a commit of about 4 ms."
    )
    housekeeping_s: Seconds = Field(
        2.0, description="How often expired leases and due schedules are looked for; alarms, each minute."
    )
    leftovers_s: Seconds = Field(
        3600.0,
        description="How long a file or folder that no row knows is watched before it is removed: what a killed "
        "process or a failed commit left.",
    )


class ExecutionSettings(WorkerSettings, JobLimitSettings, LossSettings, RecordSettings):
    """Settings of the execution, read from environment variables with the prefix SAWMILL_."""

    model_config = SettingsConfigDict(env_prefix="SAWMILL_", extra="ignore", frozen=True)

    @property
    def retries(self) -> Retries:
        """Rules for retries of jobs."""
        return Retries(self.max_attempts, self.loss_wait_s, self.outage_wait_s)

    @model_validator(mode="after")
    def _lease_outlives_heartbeats(self) -> Self:
        if self.lease_s < 2 * self.heartbeat_s:
            raise ValueError(f"lease_s must be at least twice heartbeat_s ({self.heartbeat_s}), not {self.lease_s}")
        return self


def process_name() -> str:
    """Return the host and the process id."""
    return f"{socket.gethostname()}-{os.getpid()}"


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
        raise WrongVariableError(_sentence(unknown[0]))


def _sentence(name: str) -> str:
    rests = [known.removeprefix(PREFIX) for known in KNOWN]
    nearest = difflib.get_close_matches(name.upper().removeprefix(PREFIX), rests, n=1)
    right = (
        f"did you mean {PREFIX}{nearest[0]}?" if nearest else "unset it; docs/look-up/settings.md lists the settings"
    )
    return f"{name} is no setting: {right}"
