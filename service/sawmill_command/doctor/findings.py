"""Findings of the doctor: subject, state and cure."""

from enum import StrEnum
from typing import NamedTuple


class State(StrEnum):
    """State of a subject."""

    GOOD = "good"
    WATCH = "watch"
    BAD = "bad"


class DoctorFinding(NamedTuple):
    """Result of one check: a sentence with the values seen, and the remedy, empty if nothing is to be done."""

    subject: str
    state: State
    sentence: str
    cure: str = ""


def good(subject: str, sentence: str) -> DoctorFinding:
    """Return a finding that needs nothing."""
    return DoctorFinding(subject, State.GOOD, sentence)


def watch(subject: str, sentence: str, cure: str) -> DoctorFinding:
    """Return a finding that should be mended."""
    return DoctorFinding(subject, State.WATCH, sentence, cure)


def bad(subject: str, sentence: str, cure: str) -> DoctorFinding:
    """Return a finding with which the service does not work."""
    return DoctorFinding(subject, State.BAD, sentence, cure)
