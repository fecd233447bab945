"""Saved progress of a long computation, from which the next attempt continues if the computation is interrupted."""

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]
# JSON-able.
MadeWith = Mapping[str, object]


class Keeper:
    """A store of progress, as arrays under names, which also holds the progress of an earlier attempt.

    This one keeps nothing, for commands and Python users, who start again themselves.
    """

    @property
    def has_begun(self) -> bool:
        """True if progress is worth keeping."""
        return False

    @property
    def is_due(self) -> bool:
        """True if it is time to keep progress."""
        return False

    def keep(self, name: str, arrays: Arrays, made_with: MadeWith | None = None) -> None:
        """Keep arrays in place of earlier ones of this name, with the choices that `kept` must ask for again."""

    def kept(self, name: str, made_with: MadeWith | None = None) -> Arrays | None:  # noqa: ARG002 - for others
        """Return what an earlier attempt kept; None if nothing is of the same input, options and version."""
        return None


NOTHING_KEPT = Keeper()
