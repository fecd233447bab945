"""Settings of the store of rows and files."""

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field
from pydantic_settings import BaseSettings, SettingsConfigDict


def _check_absolute(path: Path) -> Path:
    if not path.is_absolute():
        raise ValueError(f'must be a list of absolute paths, as ["/srv/watched"], not {str(path)!r}')
    return path


class LargestUpload(BaseSettings):
    """Size of an uploaded file."""

    model_config = SettingsConfigDict(env_prefix="SAWMILL_", extra="ignore", frozen=True)

    max_upload_bytes: Annotated[int, Field(gt=0)] = Field(
        8 * 2**30, description="Bytes of one upload: 360 x 1000 x 2000 numbers of four bytes are 2.9 GB."
    )


class DataSettings(BaseSettings):
    """Data and disks."""

    data_folder: Path = Field(
        default_factory=lambda: Path.home() / ".local/share/sawmill-calibration",
        description="Folder of uploads, results and (by default) the database; workers of a cluster share it.",
    )
    database_url: str | None = Field(
        None,
        description="`postgresql://user:password@host/database`; null: SQLite in the data folder, "
        "which must then be on a local disk.",
    )
    database_password_file: Path | None = Field(
        None, description="File that holds the password of that URL's user, which the URL then leaves out."
    )
    disk_reserve_bytes: Annotated[int, Field(ge=0)] = Field(
        256 * 2**20,
        description="Free bytes below which the disk counts as full, also in `/health/ready`: "
        "room for the database, and for what runs to end.",
    )
    watch_folders: list[Annotated[Path, AfterValidator(_check_absolute)]] = Field(
        [],
        description="Folders (JSON list) in which watched folders may lie; the service and its workers see "
        "them under the same paths, and the workers may write there. Empty: no folder is watched.",
    )


class QueueSettings(BaseSettings):
    """Queue."""

    max_queued_jobs: Annotated[int, Field(ge=1)] = Field(
        10_000,
        description="Jobs that may wait in all, those that are tried again included; whoever asks for another one gets "
        "429. What the service itself asks for, as by a schedule, waits beside them.",
    )
    max_queued_jobs_per_key: Annotated[int, Field(ge=1)] = Field(
        5_000, description="Of these, jobs that were asked for with one key: the 4 000 jobs of a busy day have room."
    )


class StorageSettings(DataSettings, QueueSettings):
    """Settings of the storage, read from environment variables with the prefix SAWMILL_."""

    model_config = SettingsConfigDict(env_prefix="SAWMILL_", extra="ignore", frozen=True)

    @property
    def url(self) -> str:
        """URL of the database, the default filled in."""
        return self.database_url or f"sqlite:///{self.data_folder / 'sawmill.db'}"

    @property
    def is_one_file(self) -> bool:
        """True if the database is SQLite's, which only one machine can use."""
        return self.url.startswith("sqlite")

    @property
    def is_made(self) -> bool:
        """True if there is a store, which a first start makes; a database server is assumed to have one."""
        return self.data_folder.is_dir() and (self.database_file is None or self.database_file.is_file())

    @property
    def database_file(self) -> Path | None:
        """SQLite's file; None: the database is a server."""
        return Path(self.url.partition("///")[2].partition("?")[0]) if self.is_one_file else None
