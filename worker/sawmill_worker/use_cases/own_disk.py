"""Permissions of a file on the user's own disk that an upload does not have."""

from collections.abc import Iterator
from contextlib import contextmanager

from sawmill_formats.errors import UnreadableScan


@contextmanager
def links_offered(*, followed: bool) -> Iterator[None]:
    """Name the flag that follows links where a file is refused for its links; a refused upload does not name it."""
    try:
        yield
    except UnreadableScan as error:
        if error.code != "external-storage" or followed:
            raise
        raise UnreadableScan(error.code, f"{error}, or read the other files too by --follow-links") from error
