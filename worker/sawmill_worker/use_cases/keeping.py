"""Progress that is kept: what a long computation leaves for the attempt after it, if it is ended in the middle."""

from collections.abc import Mapping
from typing import Any, Protocol

from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]
# JSON-able.
MadeWith = Mapping[str, object]


class Keeper(Protocol):
    """Takes progress, as arrays under a name, and has what an earlier attempt at the same thing gave it.

    Attributes
    ----------
    has_begun : bool
        Whether the work has taken so long that its progress is worth keeping: a short job keeps nothing.
    is_due : bool
        Whether it is time to give the newest progress.
    """

    @property
    def has_begun(self) -> bool:
        """See above."""

    @property
    def is_due(self) -> bool:
        """See above."""

    def keep(self, name: str, arrays: Arrays, made_with: MadeWith | None = None) -> None:
        """Take progress in place of what had this name.

        Parameters
        ----------
        arrays
            Of numbers.
        made_with
            What the work chose, and the progress depends on: `kept` asks for the same.
        """

    def kept(self, name: str, made_with: MadeWith | None = None) -> Arrays | None:
        """What an earlier attempt gave; None where there is nothing of the same input, options and version."""


class NothingKept:
    """For commands and Python users, who begin again themselves."""

    has_begun = False
    is_due = False

    def keep(self, name: str, arrays: Arrays, made_with: MadeWith | None = None) -> None:
        """Drop it."""

    def kept(self, name: str, made_with: MadeWith | None = None) -> Arrays | None:  # noqa: ARG002 - a `Keeper`'s
        """Nothing."""
        return None


NOTHING_KEPT = NothingKept()
