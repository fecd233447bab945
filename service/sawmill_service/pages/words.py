"""What pages call the states and methods that programs know by other names, each text marked for the catalogues."""

from typing import NamedTuple

from sawmill_service.pages.languages import marked
from sawmill_worker.contracts.jobs import JobState
from sawmill_worker.contracts.scans import ScanState
from sawmill_worker.vocabulary import ColorMap, ReconstructionMethod


class Word(NamedTuple):
    """A state: the colour's name and the word on it."""

    tone: str
    word: str


class Method(NamedTuple):
    """A method of reconstruction: its name, and when to take it."""

    name: str
    sentence: str


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
METHODS = {
    ReconstructionMethod.AUTO: Method(
        marked("Automatic"), marked("Takes the method that suits the scan's number of views and its noise.")
    ),
    ReconstructionMethod.FBP: Method(
        marked("Filtered back-projection"), marked("The fastest, for scans with many views all round.")
    ),
    ReconstructionMethod.TOTAL_VARIATION: Method(
        marked("Total variation"), marked("Sharp edges and little noise, also from few views; takes longer.")
    ),
    ReconstructionMethod.CAUCHY_MAP: Method(
        marked("Cauchy MAP"), marked("Keeps edges from as few as 20 views; takes the longest.")
    ),
    ReconstructionMethod.TIKHONOV: Method(marked("Tikhonov"), marked("A smooth picture, to compare the others with.")),
}
COLOR_MAPS = {
    ColorMap.GREY: marked("Grey"),
    ColorMap.VIRIDIS: marked("Viridis"),
    ColorMap.INFERNO: marked("Inferno"),
    ColorMap.MAGMA: marked("Magma"),
}
