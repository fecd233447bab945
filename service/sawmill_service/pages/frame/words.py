"""Words of the pages for states that programs know by other names, each marked for the catalogues."""

from typing import NamedTuple

from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.jobs import JobState
from sawmill_service.pages.frame.languages import (
    marked,
)
from sawmill_vocabulary import ColorMap


class Word(NamedTuple):
    """Word for a state, and the name of a colour."""

    tone: str
    word: str


SCAN_STATES = {
    ScanState.INGESTING: Word("busy", marked("Being read")),
    ScanState.READY: Word("good", marked("Ready")),
    ScanState.REFUSED: Word("bad", marked("Refused")),
}
LOG_STATES = {
    JobState.QUEUED: Word("idle", marked("Waiting")),
    JobState.RUNNING: Word("busy", marked("Computing")),
    JobState.SUCCEEDED: Word("good", marked("Ready")),
    JobState.FAILED: Word("bad", marked("Failed")),
    JobState.CANCELLED: Word("idle", marked("Cancelled")),
}
COLOR_MAPS = {
    ColorMap.GREY: marked("Grey"),
    ColorMap.VIRIDIS: marked("Viridis"),
    ColorMap.INFERNO: marked("Inferno"),
    ColorMap.MAGMA: marked("Magma"),
}
