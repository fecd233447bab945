"""Words of the pages for a job: its task, its state, the remaining time, the address of the result."""

from dataclasses import dataclass
from datetime import timedelta

from babel.dates import format_timedelta

from sawmill_contracts import kinds
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import Job, JobState
from sawmill_platform.contracts.kind_declarations import declaration_of
from sawmill_service.pages.frame.languages import marked
from sawmill_service.pages.frame.page_frame import PageFrame

STATES = {
    JobState.QUEUED: ("idle", marked("Waits")),
    JobState.RUNNING: ("idle", marked("Runs")),
    JobState.SUCCEEDED: ("good", marked("Done")),
    JobState.FAILED: ("bad", marked("Failed")),
    JobState.CANCELLED: ("idle", marked("Cancelled")),
}
FATES = {
    event_kinds.STARTED: marked("started"),
    event_kinds.SUCCEEDED: marked("succeeded"),
    event_kinds.FAILED: marked("failed for good"),
    event_kinds.LOST: marked("lost: its worker ended without an answer"),
    event_kinds.POSTPONED: marked("put off: an outage ended it"),
    event_kinds.GIVEN_BACK: marked("given back: its worker stopped, or another job went first"),
    event_kinds.CANCELLED: marked("cancelled"),
}
# Stages, by the names that jobs report.
STAGES = {
    "read": marked("Reading the file"),
    "inspect": marked("Reading the file"),
    "prepare": marked("Turning the numbers into attenuation"),
    "align rows": marked("Aligning the rows"),
    "rows": marked("Finding the rows that show the phantom"),
    "search": marked("Searching for the geometry"),
    "log": marked("Comparing with the log beside the phantom"),
    "pair rays": marked("Comparing opposite rays"),
    "reconstruct": marked("Computing the slices"),
    "trace": marked("Finding the outline in the picture"),
    "start": marked("Searching for the geometry"),
    "fit": marked("Searching for the geometry"),
    "bounds": marked("Searching for the geometry"),
    "result": marked("Writing the result"),
    "store": marked("Writing the result"),
}
# Link to the result of a job: its page where there is one, else the numbers.
_MADE = {
    kinds.INGEST: ("/scans/{}", marked("Open the scan")),
    kinds.CALIBRATE: ("/calibrations/{}/report", marked("Report")),
    kinds.CALIBRATE_PAIRS: ("/fixed-pairs/{}", marked("Open the result")),
    kinds.LOCATE_MARKS: ("/pair-logs/{}", marked("Open the result")),
    kinds.RECONSTRUCT: ("/logs/{}", marked("Open the log")),
    kinds.TRACE_PHANTOM: ("/phantoms/{}", marked("Open the phantom")),
}
_NUMBERS = marked("All numbers")


@dataclass(frozen=True)
class JobView:
    """A job as a page shows it."""

    job: Job
    # what, word, tone: task of the job, and its state in a word with the name of a colour.
    what: str
    word: str
    tone: str
    left: str  # remaining time; empty while nothing is known
    place: str  # position in the queue; empty for a job that runs or has ended
    # made, made_label: address of the result, and the text of the link; empty without a result.
    made: str
    made_label: str


def job_view(job: Job, page: PageFrame) -> JobView:
    """Describe a job in the page's language."""
    tone, word = STATES[job.state]
    made, label = _made(job)
    return JobView(
        job=job,
        what=page.text.gettext(declaration_of(job.kind).label),
        word=page.text.gettext(word),
        tone=tone,
        left=_left(job, page),
        place=_place(job, page),
        made=made,
        made_label=page.text.gettext(label) if label else "",
    )


def stages(page: PageFrame) -> dict[str, str]:
    """Return the stages of a running job in the page's language, by the names that the job reports."""
    return {name: page.text.gettext(text) for name, text in STAGES.items()}


def _made(job: Job) -> tuple[str, str]:
    if job.state is not JobState.SUCCEEDED:
        return "", ""
    path, label = _MADE.get(job.kind, (f"/v1/{job.kind.plural}/{{}}", _NUMBERS))
    return path.format(job.subject_id), label


def _left(job: Job, page: PageFrame) -> str:
    if job.seconds_left is None or job.state.ended:
        return ""
    if job.state is JobState.RUNNING and job.seconds_left < 1.0:
        return page.text.gettext("nearly done")
    written = format_timedelta(
        timedelta(seconds=max(job.seconds_left, 1.0)), granularity="second", locale=page.language
    )
    return page.text.gettext("about %(time)s left") % {"time": written}


def _place(job: Job, page: PageFrame) -> str:
    before = job.queue_position
    if job.state is not JobState.QUEUED or before is None:
        return ""
    if before == 0:
        return page.text.gettext("Next in line")
    return page.text.ngettext("After %(number)s other", "After %(number)s others", before) % {"number": before}
