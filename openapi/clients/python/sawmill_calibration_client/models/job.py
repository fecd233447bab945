from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.job_kind import JobKind
from ..models.job_state import JobState
from ..models.priority import Priority
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.failure import Failure
    from ..models.progress import Progress


T = TypeVar("T", bound="Job")


@_attrs_define
class Job:
    """A job as it stands."""

    attempt: int
    """ How often it was started; the number tells one attempt from another, and is not limited. """
    created_at: datetime.datetime
    """ When it was created, RFC 3339, UTC. """
    id: str
    """ The resource's id, which the service gives. """
    kind: JobKind
    """ What a worker can be asked to do. """
    state: JobState
    """ A job's life: queued, running, then one of the three ends. """
    subject_id: str
    """ What it works on, as a scan, a phantom or a calibration. """
    answered_from: None | str | Unset = UNSET
    """ Id of the earlier one of its kind whose result it has: computed of the same input, with the same parameters
    and the same version of the software. The seconds in the result are those of that computation. Null: it was
    computed itself, or has no result. """
    asked_by: None | str | Unset = UNSET
    """ The name of the key with which it was asked for, or who else did; null: an earlier version's. """
    background: bool | Unset = False
    """ As the examples: starts when no other job could, and gives way to one. """
    cancel_requested: bool | Unset = False
    """ Whether somebody has cancelled it; a running one ends within seconds. """
    failure: Failure | None | Unset = UNSET
    """ Why it failed. Null: it has not. """
    finished_at: datetime.datetime | None | Unset = UNSET
    """ When it ended, RFC 3339, UTC. Null: it has not ended. """
    key_id: None | str | Unset = UNSET
    """ Id of the key that this request brought; null: none. """
    losses: int | Unset = 0
    """ Number of attempts that were lost, as by a worker that was killed; the third loss fails the job. A clean
    stop of a worker, a full disk and a database that is away are no loss. """
    not_before: datetime.datetime | None | Unset = UNSET
    """ While it waits to be tried again: the earliest time. """
    priority: Priority | Unset = UNSET
    """ Which job comes first: somebody waits for it, it is one of many as of a schedule, or it is for idle times.
    """
    progress: None | Progress | Unset = UNSET
    """ How far it is. Null: it does not run. """
    queue_position: int | None | Unset = UNSET
    """ Number of jobs before it in the queue, of a short one those of its lane; null once it runs. """
    request_id: None | str | Unset = UNSET
    """ The `X-Request-Id` of the request that queued it; null: none did, as for a schedule's. """
    seconds_left: float | None | Unset = UNSET
    """ About how many seconds until it succeeds: by its progress, and by how long jobs of its kind took lately,
    with those before it. Null: nothing is known, or it has ended. """
    short: bool | Unset = False
    """ It takes seconds: it has a lane in which none waits for a long one, as a reconstruction. """
    started_at: datetime.datetime | None | Unset = UNSET
    """ When its last attempt started, RFC 3339, UTC. Null: it has not started, or an earlier result answered it at
    once. """
    waiting_for: Failure | None | Unset = UNSET
    """ While it waits to be tried again: the passing failure because of which it does. """
    worker: None | str | Unset = UNSET
    """ Host and process of the worker that has it. Null: none has. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.failure import Failure  # noqa: PLC0415
        from ..models.progress import Progress  # noqa: PLC0415

        attempt = self.attempt

        created_at = self.created_at.isoformat()

        id = self.id

        kind = self.kind.value

        state = self.state.value

        subject_id = self.subject_id

        answered_from: None | str | Unset
        if isinstance(self.answered_from, Unset):
            answered_from = UNSET
        else:
            answered_from = self.answered_from

        asked_by: None | str | Unset
        if isinstance(self.asked_by, Unset):
            asked_by = UNSET
        else:
            asked_by = self.asked_by

        background = self.background

        cancel_requested = self.cancel_requested

        failure: dict[str, Any] | None | Unset
        if isinstance(self.failure, Unset):
            failure = UNSET
        elif isinstance(self.failure, Failure):
            failure = self.failure.to_dict()
        else:
            failure = self.failure

        finished_at: None | str | Unset
        if isinstance(self.finished_at, Unset):
            finished_at = UNSET
        elif isinstance(self.finished_at, datetime.datetime):
            finished_at = self.finished_at.isoformat()
        else:
            finished_at = self.finished_at

        key_id: None | str | Unset
        if isinstance(self.key_id, Unset):
            key_id = UNSET
        else:
            key_id = self.key_id

        losses = self.losses

        not_before: None | str | Unset
        if isinstance(self.not_before, Unset):
            not_before = UNSET
        elif isinstance(self.not_before, datetime.datetime):
            not_before = self.not_before.isoformat()
        else:
            not_before = self.not_before

        priority: str | Unset = UNSET
        if not isinstance(self.priority, Unset):
            priority = self.priority.value

        progress: dict[str, Any] | None | Unset
        if isinstance(self.progress, Unset):
            progress = UNSET
        elif isinstance(self.progress, Progress):
            progress = self.progress.to_dict()
        else:
            progress = self.progress

        queue_position: int | None | Unset
        if isinstance(self.queue_position, Unset):
            queue_position = UNSET
        else:
            queue_position = self.queue_position

        request_id: None | str | Unset
        if isinstance(self.request_id, Unset):
            request_id = UNSET
        else:
            request_id = self.request_id

        seconds_left: float | None | Unset
        if isinstance(self.seconds_left, Unset):
            seconds_left = UNSET
        else:
            seconds_left = self.seconds_left

        short = self.short

        started_at: None | str | Unset
        if isinstance(self.started_at, Unset):
            started_at = UNSET
        elif isinstance(self.started_at, datetime.datetime):
            started_at = self.started_at.isoformat()
        else:
            started_at = self.started_at

        waiting_for: dict[str, Any] | None | Unset
        if isinstance(self.waiting_for, Unset):
            waiting_for = UNSET
        elif isinstance(self.waiting_for, Failure):
            waiting_for = self.waiting_for.to_dict()
        else:
            waiting_for = self.waiting_for

        worker: None | str | Unset
        if isinstance(self.worker, Unset):
            worker = UNSET
        else:
            worker = self.worker

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "attempt": attempt,
                "created_at": created_at,
                "id": id,
                "kind": kind,
                "state": state,
                "subject_id": subject_id,
            }
        )
        if answered_from is not UNSET:
            field_dict["answered_from"] = answered_from
        if asked_by is not UNSET:
            field_dict["asked_by"] = asked_by
        if background is not UNSET:
            field_dict["background"] = background
        if cancel_requested is not UNSET:
            field_dict["cancel_requested"] = cancel_requested
        if failure is not UNSET:
            field_dict["failure"] = failure
        if finished_at is not UNSET:
            field_dict["finished_at"] = finished_at
        if key_id is not UNSET:
            field_dict["key_id"] = key_id
        if losses is not UNSET:
            field_dict["losses"] = losses
        if not_before is not UNSET:
            field_dict["not_before"] = not_before
        if priority is not UNSET:
            field_dict["priority"] = priority
        if progress is not UNSET:
            field_dict["progress"] = progress
        if queue_position is not UNSET:
            field_dict["queue_position"] = queue_position
        if request_id is not UNSET:
            field_dict["request_id"] = request_id
        if seconds_left is not UNSET:
            field_dict["seconds_left"] = seconds_left
        if short is not UNSET:
            field_dict["short"] = short
        if started_at is not UNSET:
            field_dict["started_at"] = started_at
        if waiting_for is not UNSET:
            field_dict["waiting_for"] = waiting_for
        if worker is not UNSET:
            field_dict["worker"] = worker

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.failure import Failure  # noqa: PLC0415
        from ..models.progress import Progress  # noqa: PLC0415

        d = dict(src_dict)
        attempt = d.pop("attempt")

        created_at = datetime.datetime.fromisoformat(d.pop("created_at"))

        id = d.pop("id")

        kind = JobKind(d.pop("kind"))

        state = JobState(d.pop("state"))

        subject_id = d.pop("subject_id")

        def _parse_answered_from(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        answered_from = _parse_answered_from(d.pop("answered_from", UNSET))

        def _parse_asked_by(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        asked_by = _parse_asked_by(d.pop("asked_by", UNSET))

        background = d.pop("background", UNSET)

        cancel_requested = d.pop("cancel_requested", UNSET)

        def _parse_failure(data: object) -> Failure | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                failure_type_0 = Failure.from_dict(data)

                return failure_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(Failure | None | Unset, data)

        failure = _parse_failure(d.pop("failure", UNSET))

        def _parse_finished_at(data: object) -> datetime.datetime | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                finished_at_type_0 = datetime.datetime.fromisoformat(data)

                return finished_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None | Unset, data)

        finished_at = _parse_finished_at(d.pop("finished_at", UNSET))

        def _parse_key_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        key_id = _parse_key_id(d.pop("key_id", UNSET))

        losses = d.pop("losses", UNSET)

        def _parse_not_before(data: object) -> datetime.datetime | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                not_before_type_0 = datetime.datetime.fromisoformat(data)

                return not_before_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None | Unset, data)

        not_before = _parse_not_before(d.pop("not_before", UNSET))

        _priority = d.pop("priority", UNSET)
        priority: Priority | Unset
        if isinstance(_priority, Unset):
            priority = UNSET
        else:
            priority = Priority(_priority)

        def _parse_progress(data: object) -> None | Progress | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                progress_type_0 = Progress.from_dict(data)

                return progress_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | Progress | Unset, data)

        progress = _parse_progress(d.pop("progress", UNSET))

        def _parse_queue_position(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        queue_position = _parse_queue_position(d.pop("queue_position", UNSET))

        def _parse_request_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        request_id = _parse_request_id(d.pop("request_id", UNSET))

        def _parse_seconds_left(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        seconds_left = _parse_seconds_left(d.pop("seconds_left", UNSET))

        short = d.pop("short", UNSET)

        def _parse_started_at(data: object) -> datetime.datetime | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                started_at_type_0 = datetime.datetime.fromisoformat(data)

                return started_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None | Unset, data)

        started_at = _parse_started_at(d.pop("started_at", UNSET))

        def _parse_waiting_for(data: object) -> Failure | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                waiting_for_type_0 = Failure.from_dict(data)

                return waiting_for_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(Failure | None | Unset, data)

        waiting_for = _parse_waiting_for(d.pop("waiting_for", UNSET))

        def _parse_worker(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        worker = _parse_worker(d.pop("worker", UNSET))

        job = cls(
            attempt=attempt,
            created_at=created_at,
            id=id,
            kind=kind,
            state=state,
            subject_id=subject_id,
            answered_from=answered_from,
            asked_by=asked_by,
            background=background,
            cancel_requested=cancel_requested,
            failure=failure,
            finished_at=finished_at,
            key_id=key_id,
            losses=losses,
            not_before=not_before,
            priority=priority,
            progress=progress,
            queue_position=queue_position,
            request_id=request_id,
            seconds_left=seconds_left,
            short=short,
            started_at=started_at,
            waiting_for=waiting_for,
            worker=worker,
        )

        return job
