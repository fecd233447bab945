"""What a backup or a restore cannot do as things are."""

from sawmill_platform.errors import StorageError


class Refused(StorageError):  # noqa: N818 - an outcome
    """Something stands in its way; the sentence says what to change."""
