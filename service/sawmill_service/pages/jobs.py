"""Page of jobs: those that run now, those that wait, and how the last ones ended."""

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Literal, NamedTuple

from fastapi import Query
from fastapi.responses import HTMLResponse, RedirectResponse

from sawmill_contracts.declared_kinds import KINDS
from sawmill_platform.contracts.base import Identifier, Page
from sawmill_platform.contracts.jobs import Job, JobKind, JobState
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import Conflict
from sawmill_platform.jobs.job_store import Jobs
from sawmill_service.dependencies import TheStore
from sawmill_service.http.responses.answers import Paging
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_service.pages.job_words import FATES, STATES, JobView, job_view, stages

JOBS = "/jobs"
# Longest list: it fits on a screen, and is read again every few seconds.
LISTED = 20

router = Router(include_in_schema=False, reading=Scope.READ)


class JobsPageFilter(Paging):
    """Filter of the jobs on the page; the empty text of a form's first choice selects all."""

    kind: JobKind | Literal[""] = ""
    state: JobState | Literal[""] = ""


class JobsShown(NamedTuple):
    """Jobs on the page; None for a list that was not requested."""

    # running, queued, ended: the first few of each: in the queue those whose turn is next, of ended jobs those
    # requested last.
    running: list[JobView] | None
    queued: list[JobView] | None
    ended: list[JobView] | None
    following: str | None  # cursor from which older ones are listed
    counts: Mapping[JobState, int]  # number of jobs in each state, of every kind
    older: bool  # True if this is a list of older jobs, which does not change by itself


TheJobsFilter = Annotated[JobsPageFilter, Query()]


@router.get(JOBS)
def jobs(page: ThePage, store: TheStore, chosen: TheJobsFilter) -> HTMLResponse:
    """Show the page."""
    return _answer("jobs.html", page, store.jobs, chosen)


@router.get(f"{JOBS}/now")
def now(page: ThePage, store: TheStore, chosen: TheJobsFilter) -> HTMLResponse:
    """Return the part of the page that changes, for its script."""
    return _answer("jobs_now.html", page, store.jobs, chosen)


@router.get(JOBS + "/{job_id}/history")
def history(job_id: Identifier, page: ThePage, store: TheStore) -> HTMLResponse:
    """Show the attempts at a job and the outcome of each, as a part of the page."""
    return page.answer("job_history.html", events=store.events.of_job(job_id), fates=FATES)


@router.post(JOBS + "/{job_id}/cancel", needs=Scope.SUBMIT)
def cancel(job_id: Identifier, store: TheStore) -> RedirectResponse:
    """Cancel a job; a job that has already ended is left as it is, and the page shows how it ended."""
    try:
        store.jobs.request_cancel(job_id)
    except Conflict:
        store.jobs.get(job_id)
    return RedirectResponse(JOBS, status_code=303)


def _answer(template: str, page: PageFrame, jobs: Jobs, chosen: JobsPageFilter) -> HTMLResponse:
    shown = _shown(page, jobs, chosen)
    kinds = {declared.kind: declared.label for declared in KINDS}
    return page.answer(
        template, shown=shown, kinds=kinds, states=STATES, stages=stages(page), kind=chosen.kind, state=chosen.state
    )


def _shown(page: PageFrame, jobs: Jobs, chosen: JobsPageFilter) -> JobsShown:
    kind, older = chosen.kind or None, chosen.after is not None

    def views(state: JobState, first: Callable[[], Sequence[Job]]) -> list[JobView] | None:
        return [job_view(job, page) for job in first()] if chosen.state in {"", state} and not older else None

    ended = _ended(jobs, chosen)
    return JobsShown(
        running=views(JobState.RUNNING, lambda: jobs.page(state=JobState.RUNNING, kind=kind, limit=LISTED).items),
        queued=views(JobState.QUEUED, lambda: jobs.waiting_in_line(kind=kind, limit=LISTED)),
        ended=None if ended is None else [job_view(job, page) for job in ended.items],
        following=ended.next if ended else None,
        counts=jobs.counts(),
        older=older,
    )


def _ended(jobs: Jobs, chosen: JobsPageFilter) -> Page[Job] | None:
    kind, state = chosen.kind or None, chosen.state
    if state and not state.ended:
        return None
    return jobs.page(state=state or None, kind=kind, ended=not state, after=chosen.after, limit=LISTED)
