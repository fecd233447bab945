from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.unfinished_state import UnfinishedState
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.calibration_links import CalibrationLinks
    from ..models.calibration_options import CalibrationOptions
    from ..models.failure import Failure


T = TypeVar("T", bound="CalibrationUnfinished")


@_attrs_define
class CalibrationUnfinished:
    """Waiting, running, or ended without an answer."""

    created_at: datetime.datetime
    """ When it was created, RFC 3339, UTC. """
    id: str
    """ The resource's id, which the service gives. """
    job_id: str
    """ Id of the job that computes it. """
    options: CalibrationOptions
    """ How to calibrate, apart from what. """
    phantom_id: str
    """ Id of the phantom. """
    scan_id: str
    """ Id of the scan that shows the phantom. """
    scanner_id: str
    """ Id of the scanner that is calibrated. """
    state: UnfinishedState
    """ A job's states but `succeeded`: those in which there is no answer. """
    answered_from: None | str | Unset = UNSET
    """ Id of the earlier one of its kind whose result it has: computed of the same input, with the same parameters
    and the same version of the software. The seconds in the result are those of that computation. Null: it was
    computed itself, or has no result. """
    failure: Failure | None | Unset = UNSET
    """ Why it failed. Null: it has not. """
    links: CalibrationLinks | None | Unset = UNSET
    """ Where it and its files are. """
    schedule_id: None | str | Unset = UNSET
    """ Id of the schedule that asked for it. Null: a person or a program did. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.calibration_links import CalibrationLinks  # noqa: PLC0415
        from ..models.failure import Failure  # noqa: PLC0415

        created_at = self.created_at.isoformat()

        id = self.id

        job_id = self.job_id

        options = self.options.to_dict()

        phantom_id = self.phantom_id

        scan_id = self.scan_id

        scanner_id = self.scanner_id

        state = self.state.value

        answered_from: None | str | Unset
        if isinstance(self.answered_from, Unset):
            answered_from = UNSET
        else:
            answered_from = self.answered_from

        failure: dict[str, Any] | None | Unset
        if isinstance(self.failure, Unset):
            failure = UNSET
        elif isinstance(self.failure, Failure):
            failure = self.failure.to_dict()
        else:
            failure = self.failure

        links: dict[str, Any] | None | Unset
        if isinstance(self.links, Unset):
            links = UNSET
        elif isinstance(self.links, CalibrationLinks):
            links = self.links.to_dict()
        else:
            links = self.links

        schedule_id: None | str | Unset
        if isinstance(self.schedule_id, Unset):
            schedule_id = UNSET
        else:
            schedule_id = self.schedule_id

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "created_at": created_at,
                "id": id,
                "job_id": job_id,
                "options": options,
                "phantom_id": phantom_id,
                "scan_id": scan_id,
                "scanner_id": scanner_id,
                "state": state,
            }
        )
        if answered_from is not UNSET:
            field_dict["answered_from"] = answered_from
        if failure is not UNSET:
            field_dict["failure"] = failure
        if links is not UNSET:
            field_dict["links"] = links
        if schedule_id is not UNSET:
            field_dict["schedule_id"] = schedule_id

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.calibration_links import CalibrationLinks  # noqa: PLC0415
        from ..models.calibration_options import CalibrationOptions  # noqa: PLC0415
        from ..models.failure import Failure  # noqa: PLC0415

        d = dict(src_dict)
        created_at = datetime.datetime.fromisoformat(d.pop("created_at"))

        id = d.pop("id")

        job_id = d.pop("job_id")

        options = CalibrationOptions.from_dict(d.pop("options"))

        phantom_id = d.pop("phantom_id")

        scan_id = d.pop("scan_id")

        scanner_id = d.pop("scanner_id")

        state = UnfinishedState(d.pop("state"))

        def _parse_answered_from(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        answered_from = _parse_answered_from(d.pop("answered_from", UNSET))

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

        def _parse_links(data: object) -> CalibrationLinks | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                links_type_0 = CalibrationLinks.from_dict(data)

                return links_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(CalibrationLinks | None | Unset, data)

        links = _parse_links(d.pop("links", UNSET))

        def _parse_schedule_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        schedule_id = _parse_schedule_id(d.pop("schedule_id", UNSET))

        calibration_unfinished = cls(
            created_at=created_at,
            id=id,
            job_id=job_id,
            options=options,
            phantom_id=phantom_id,
            scan_id=scan_id,
            scanner_id=scanner_id,
            state=state,
            answered_from=answered_from,
            failure=failure,
            links=links,
            schedule_id=schedule_id,
        )

        return calibration_unfinished
