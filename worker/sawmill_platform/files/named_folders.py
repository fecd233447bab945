"""Folders of the data folder in which rows name files, as the package that owns the rows declares them."""

from collections.abc import Callable
from dataclasses import dataclass

from sqlalchemy import Select, select

from sawmill_platform.contracts.jobs import UNFINISHED
from sawmill_platform.contracts.uploads import UploadState
from sawmill_platform.database.clock import Clock
from sawmill_platform.database.tables import JobRow, UploadRow
from sawmill_platform.files import file_store

Ids = Select[str]
"""Statement that selects ids, to which a condition may be added."""


@dataclass(frozen=True)
class NamedFolder:
    """A folder of the data folder that has a folder for each id of some rows."""

    path: str  # path in the data folder, with slashes
    ids: Callable[[Clock], Ids]  # maps a clock to the statement of the ids whose files are kept now
    file: str | None = None  # name of the file that each folder must have. None: a folder may be missing.


def unused_uploads() -> Ids:
    """Select the uploads that may have a file in `unfinished`."""
    return select(UploadRow.id).where(UploadRow.state != UploadState.USED)


OF_THE_SERVICE = (
    NamedFolder("kept", lambda _: select(JobRow.id).where(JobRow.state.in_(UNFINISHED))),
    NamedFolder(file_store.UNFINISHED, lambda _: unused_uploads()),
)
"""Folders of checkpoints and unfinished uploads."""
