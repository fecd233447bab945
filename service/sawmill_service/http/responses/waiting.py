"""Long polls: a request that waits for the end of a job holds no thread, and reads the database before and after."""

import asyncio
import time
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from starlette.types import Receive

from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.event_kinds import JOB_ENDS
from sawmill_platform.contracts.jobs import Job, JobState
from sawmill_platform.errors import StorageUnavailable
from sawmill_service.event_feed import EventFeed
from sawmill_service.stopping import Stopping

MOST_S = 60.0
# Proxies give up a request that is silent for a minute, as nginx does by default.
_LONGEST_S = 55.0
# Threads for hundreds of requests that wait for one end: the other threads remain for further requests.
_READERS = 8
_UNFINISHED = {JobState.QUEUED, JobState.RUNNING, ScanState.INGESTING, PhantomState.TRACING}

Answer = TypeVar("Answer")


class JobEnds:
    """Ends of jobs for the requests that wait: one reader of events for all, and none while no request waits."""

    def __init__(self, feed: EventFeed, stopping: Stopping, poll_s: float) -> None:
        self._feed, self._stopping, self._poll_s = feed, stopping, poll_s
        self._waiting: dict[str, set[asyncio.Future[None]]] = {}
        self._readers = asyncio.Semaphore(_READERS)
        self._watcher: asyncio.Task[None] | None = None
        self._begun: asyncio.Future[None]

    async def read(
        self, read: Callable[[], Answer], wait_s: float, until_gone: Callable[[], Coroutine[Any, Any, None]]
    ) -> Answer:
        """Return an answer once its job has ended, or its state after the wait."""
        answer = await run_in_threadpool(read)
        if wait_s <= 0.0 or not is_unfinished(answer):
            return answer
        return await self._read_when_ended(read, _job_id(answer), min(wait_s, _LONGEST_S), until_gone)

    async def _read_when_ended(
        self,
        read: Callable[[], Answer],
        job_id: str,
        wait_s: float,
        until_gone: Callable[[], Coroutine[Any, Any, None]],
    ) -> Answer:
        waiting, ended = self._waiting.setdefault(job_id, set()), asyncio.get_running_loop().create_future()
        waiting.add(ended)
        gone = asyncio.create_task(until_gone())
        until_s = time.monotonic() + wait_s

        async def wait_for(what: asyncio.Future[None]) -> None:
            left_s = max(0.0, until_s - time.monotonic())
            await asyncio.wait([what, gone], timeout=left_s, return_when=asyncio.FIRST_COMPLETED)

        try:
            await wait_for(begun := self._watch())
            if begun.done():
                begun.result()
                # From here on no end is missed; the answer shows an earlier end.
                answer = await self._again(read)
                if not is_unfinished(answer):
                    return answer
                await wait_for(ended)
            return await self._again(read)
        finally:
            gone.cancel()
            waiting.discard(ended)
            if not waiting:
                self._waiting.pop(job_id, None)

    async def _again(self, read: Callable[[], Answer]) -> Answer:
        async with self._readers:
            return await run_in_threadpool(read)

    def _watch(self) -> "asyncio.Future[None]":
        """Start a reader of events if there is none; the result is done once it reads."""
        if self._watcher is None or self._watcher.done():
            self._begun = asyncio.get_running_loop().create_future()
            self._watcher = asyncio.create_task(self._follow(self._begun))
        return self._begun

    async def _follow(self, begun: "asyncio.Future[None]") -> None:
        try:
            number = await self._feed.start(None)
        except Exception as error:  # noqa: BLE001 - the waiting requests raise it
            begun.set_exception(error)
            return
        begun.set_result(None)
        while self._waiting and not self._stopping.begun:
            await self._stopping.sleep(self._poll_s)
            try:
                number, events = await self._feed.after(number)
            except StorageUnavailable:
                continue
            self._wake({event.job_id for event in events if event.type in JOB_ENDS})
        self._wake(set(self._waiting))

    def _wake(self, job_ids: set[str | None]) -> None:
        for job_id in job_ids & self._waiting.keys():
            for ended in self._waiting[job_id or ""]:
                if not ended.done():
                    ended.set_result(None)


async def until_gone(receive: Receive) -> None:
    """Return when the client has gone; a body is ignored."""
    while (await receive())["type"] != "http.disconnect":
        pass


def is_unfinished(answer: Any) -> bool:  # noqa: ANN401 - a job, or a resource that a job works on
    """Return whether a job, or the job of a scan, a phantom or another resource, has not ended."""
    return answer.state in _UNFINISHED


def _job_id(answer: Any) -> str:  # noqa: ANN401 - the same
    return answer.id if isinstance(answer, Job) else answer.job_id


class WaitOption:
    """Query option `wait` of a request."""

    def __init__(
        self,
        request: Request,
        response: Response,
        wait: Annotated[
            float,
            Query(
                ge=0,
                le=MOST_S,
                allow_inf_nan=False,
                description="Seconds to wait for the end of the job, 55 at most: the answer comes when the job has "
                "ended, or its present state when the time is over. 0 does not wait.",
            ),
        ] = 0.0,
    ) -> None:
        self._ends: JobEnds = request.app.state.job_ends
        self._retry_after_s: int = request.app.state.settings.retry_after_s
        self._request, self._response, self._wait_s = request, response, wait

    async def read(self, read: Callable[[], Answer]) -> Answer:
        """Return an answer after the wait, with `Retry-After` if its job has not ended."""
        answer = await self._ends.read(read, self._wait_s, partial(until_gone, self._request.receive))
        if is_unfinished(answer):
            self._response.headers["Retry-After"] = str(self._retry_after_s)
        return answer


TheWaiting = Annotated[WaitOption, Depends()]
