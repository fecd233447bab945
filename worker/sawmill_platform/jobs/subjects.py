"""What the package that owns the kinds of jobs gives to the job store."""

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from sqlalchemy.orm import Session

from sawmill_platform.contracts.attempts import AttemptInput
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.database.tables import JobRow
from sawmill_platform.files.file_store import FileStore
from sawmill_platform.files.named_folders import NamedFolder


class Recorded(NamedTuple):
    """A result for the ledger: a sentence for the history, and details for the event, which go to all followers."""

    why: str | None = None
    detail: Mapping[str, Any] = {}


class Subjects(NamedTuple):
    """Folders in which rows name files, and functions on the rows and files that jobs work on.

    Functions with a session are called within the job store's transaction. `handed_over` returns the input of an
    attempt, or raises `NotFound` if something was deleted since the request; `record_success` and
    `record_end_without_result` write a job's end to its subject, by its id; `output_file` returns the file that a job
    left, unopened, or raises `InvalidOutput`; `read_apart` reads a result of an earlier version, which has no digest,
    in a separate process, or raises `DamagedResult`.
    """

    named_folders: Sequence[NamedFolder]
    handed_over: Callable[[Session, FileStore, JobRow], AttemptInput]
    record_success: Callable[[Session, JobKind, str, Contract, datetime], Recorded]
    record_end_without_result: Callable[[Session, JobKind, str, str, datetime], None]
    output_file: Callable[[JobKind, Path], Path | None]
    read_apart: Callable[[Path], None]
