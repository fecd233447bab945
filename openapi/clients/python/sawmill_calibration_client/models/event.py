from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.event_kind import EventKind
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.event_detail_type_0 import EventDetailType0


T = TypeVar("T", bound="Event")


@_attrs_define
class Event:
    """One thing that happened."""

    at: datetime.datetime
    """ RFC 3339, UTC. """
    number: int
    """ Number of the event; it grows from event to event, not always by 1. """
    what: EventKind
    """ What happened. """
    attempt: int | None | Unset = UNSET
    """ Number of the attempt at the job. Null: it is of no attempt. """
    detail: EventDetailType0 | None | Unset = UNSET
    """ As the failure of an attempt and, where its process could tell, `peak_memory_bytes`; `answered_from`, the id
    of the earlier one whose result answered a job; `reason` of an activation, a refusal, a paused webhook or a
    missed due time, which is `due_at`; `used_by`, the address of what was made of an upload, or the `reason` of its
    end; an alarm as `/v1/alarms` has it; the name of a backup and when it was taken; `number`, `freed_bytes`,
    `first_at` and `last_at` of what went by rules of retention; or seconds of the clock. """
    job_id: None | str | Unset = UNSET
    """ Id of the job that it concerns. Null: none. """
    scanner_id: None | str | Unset = UNSET
    """ The scanner that it concerns, where there is one. """
    subject: None | str | Unset = UNSET
    """ What `subject_id` names: `scanner`, `scan`, `phantom`, `calibration`, `reconstruction`, `plan`, `drift`,
    `inspection`, `schedule`, `upload`, `key`, `webhook` or `retention`. """
    subject_id: None | str | Unset = UNSET
    """ What it happened to; of a job, what the job works on. Null in events of earlier versions. """
    worker: None | str | Unset = UNSET
    """ Host and process. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.event_detail_type_0 import EventDetailType0  # noqa: PLC0415

        at = self.at.isoformat()

        number = self.number

        what = self.what.value

        attempt: int | None | Unset
        if isinstance(self.attempt, Unset):
            attempt = UNSET
        else:
            attempt = self.attempt

        detail: dict[str, Any] | None | Unset
        if isinstance(self.detail, Unset):
            detail = UNSET
        elif isinstance(self.detail, EventDetailType0):
            detail = self.detail.to_dict()
        else:
            detail = self.detail

        job_id: None | str | Unset
        if isinstance(self.job_id, Unset):
            job_id = UNSET
        else:
            job_id = self.job_id

        scanner_id: None | str | Unset
        if isinstance(self.scanner_id, Unset):
            scanner_id = UNSET
        else:
            scanner_id = self.scanner_id

        subject: None | str | Unset
        if isinstance(self.subject, Unset):
            subject = UNSET
        else:
            subject = self.subject

        subject_id: None | str | Unset
        if isinstance(self.subject_id, Unset):
            subject_id = UNSET
        else:
            subject_id = self.subject_id

        worker: None | str | Unset
        if isinstance(self.worker, Unset):
            worker = UNSET
        else:
            worker = self.worker

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "at": at,
                "number": number,
                "what": what,
            }
        )
        if attempt is not UNSET:
            field_dict["attempt"] = attempt
        if detail is not UNSET:
            field_dict["detail"] = detail
        if job_id is not UNSET:
            field_dict["job_id"] = job_id
        if scanner_id is not UNSET:
            field_dict["scanner_id"] = scanner_id
        if subject is not UNSET:
            field_dict["subject"] = subject
        if subject_id is not UNSET:
            field_dict["subject_id"] = subject_id
        if worker is not UNSET:
            field_dict["worker"] = worker

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.event_detail_type_0 import EventDetailType0  # noqa: PLC0415

        d = dict(src_dict)
        at = datetime.datetime.fromisoformat(d.pop("at"))

        number = d.pop("number")

        what = EventKind(d.pop("what"))

        def _parse_attempt(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        attempt = _parse_attempt(d.pop("attempt", UNSET))

        def _parse_detail(data: object) -> EventDetailType0 | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                detail_type_0 = EventDetailType0.from_dict(data)

                return detail_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(EventDetailType0 | None | Unset, data)

        detail = _parse_detail(d.pop("detail", UNSET))

        def _parse_job_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        job_id = _parse_job_id(d.pop("job_id", UNSET))

        def _parse_scanner_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        scanner_id = _parse_scanner_id(d.pop("scanner_id", UNSET))

        def _parse_subject(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        subject = _parse_subject(d.pop("subject", UNSET))

        def _parse_subject_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        subject_id = _parse_subject_id(d.pop("subject_id", UNSET))

        def _parse_worker(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        worker = _parse_worker(d.pop("worker", UNSET))

        event = cls(
            at=at,
            number=number,
            what=what,
            attempt=attempt,
            detail=detail,
            job_id=job_id,
            scanner_id=scanner_id,
            subject=subject,
            subject_id=subject_id,
            worker=worker,
        )

        return event
