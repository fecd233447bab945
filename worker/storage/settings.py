"""Where rows and files are kept."""

from pathlib import Path

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict


class StorageSettings(BaseSettings):
    """Read from the environment, prefix SAWMILL_."""

    model_config = SettingsConfigDict(env_prefix="SAWMILL_", extra="ignore", frozen=True)

    data_folder: Path = Field(
        default_factory=lambda: Path.home() / ".local/share/sawmill-calibration",
        description="Folder of uploads, results and (by default) the database; workers of a cluster share it.",
    )
    database_url: str | None = Field(
        None,
        description="SQLAlchemy URL; null: SQLite in the data folder, which must then be on a local disk.",
    )

    @property
    def url(self) -> str:
        """The database's URL, the default filled in."""
        return self.database_url or f"sqlite:///{self.data_folder / 'sawmill.db'}"
