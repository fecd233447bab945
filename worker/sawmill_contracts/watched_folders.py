"""The folder into which a scanner writes its scans, for scanners that can only write files."""

from fnmatch import fnmatchcase
from pathlib import PurePosixPath
from typing import Annotated

from pydantic import AfterValidator, Field, StringConstraints

from sawmill_contracts.row_ranges import Rows
from sawmill_contracts.scans import ScanFileOptions
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.jobs import Priority


def _check_path(text: str) -> str:
    if not text.startswith("/") or ".." in PurePosixPath(text).parts:
        raise ValueError(f"must be an absolute path without .., as /srv/scanners/line-2, not {text!r}")
    return text


Pattern = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=r"^[^/]*$")]


class WatchedFiles(ScanFileOptions, Given):
    """Files of one kind in a watched folder, and how each of them is read."""

    match: Pattern = Field(
        description="Names of the files, with * for any letters, ? for one and [...] for one of several.",
        examples=["phantom*.h5"],
    )
    phantom_id: Identifier | None = Field(None, description="Id of the phantom in each file; null for logs.")
    phantom_rows: Rows | None = Field(None, description="Rows that show the phantom; null: they are found.")
    priority: Priority = Field(Priority.INTERACTIVE, description="Priority of the jobs that read the files.")


class WatchedFolder(WatchedFiles):
    """A folder whose files become scans of the scanner, once each."""

    match: Pattern = Field("*", description="Names of all other files that are taken.", examples=["*.h5"])
    folder: Annotated[str, StringConstraints(min_length=1, max_length=1000), AfterValidator(_check_path)] = Field(
        description="Absolute path of the folder, in a folder of `SAWMILL_WATCH_FOLDERS`.",
        examples=["/srv/scanners/line-2"],
        json_schema_extra={"pattern": "^/"},
    )
    still_for_s: Annotated[float, Field(gt=0, le=86_400)] | None = Field(
        10.0,
        description="A file is complete when its size and time have not changed for this number of seconds. Null: only "
        "when there is a file NAME.done next to NAME.",
    )
    exceptions: list[WatchedFiles] = Field(
        [], max_length=20, description="Files that are read in another way; the first that matches a name counts."
    )

    def files_named(self, name: str) -> WatchedFiles | None:
        """Return how a file of this name is read; None if it is not taken."""
        return next((files for files in (*self.exceptions, self) if fnmatchcase(name, files.match)), None)
