"""What was looked at, how it is, and the cure."""

from enum import StrEnum
from typing import NamedTuple


class State(StrEnum):
    """How something is."""

    GOOD = "good"
    WATCH = "watch"
    BAD = "bad"


class Finding(NamedTuple):
    """One thing that was looked at.

    Attributes
    ----------
    subject : str
        What.
    state : State
        How it is.
    sentence : str
        With the values seen.
    cure : str
        What to do; empty where nothing is to be done.
    """

    subject: str
    state: State
    sentence: str
    cure: str = ""
