"""Errors of backups and restores."""

from sawmill_platform.errors import StorageError


class BackupRefused(StorageError):  # noqa: N818 - an outcome
    """A backup or a restore is not possible now; the sentence says what to change."""
