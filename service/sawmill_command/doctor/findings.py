"""Findings of the doctor: subject, state and cure."""

from enum import StrEnum
from typing import NamedTuple


class State(StrEnum):
    """State of a subject."""

    GOOD = "good"
    WATCH = "watch"
    BAD = "bad"


class DoctorFinding(NamedTuple):
    """Result of one check.

    Attributes
    ----------
    subject : str
        The checked subject.
    state : State
        State of the subject.
    sentence : str
        Description with the values seen.
    cure : str
        The remedy; empty if nothing is to be done.
    """

    subject: str
    state: State
    sentence: str
    cure: str = ""
