from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.job_state import JobState
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.failure import Failure
    from ..models.inspected_file import InspectedFile
    from ..models.inspection_links import InspectionLinks
    from ..models.inspection_result import InspectionResult


T = TypeVar("T", bound="Inspection")


@_attrs_define
class Inspection:
    """An inspection as it stands. It succeeds for a file that cannot be read too: its result has the reason."""

    created_at: datetime.datetime
    """ When it was created, RFC 3339, UTC. """
    file_kept_until: datetime.datetime
    """ Until then scans can be made of its file. """
    id: str
    """ The resource's id, which the service gives. """
    job_id: str
    """ Id of the job that looks at the file. """
    options: InspectedFile
    """ The file beside them. """
    state: JobState
    """ A job's life: queued, running, then one of the three ends. """
    answered_from: None | str | Unset = UNSET
    """ Id of the earlier one of its kind whose result it has: computed of the same input, with the same parameters
    and the same version of the software. The seconds in the result are those of that computation. Null: it was
    computed itself, or has no result. """
    failure: Failure | None | Unset = UNSET
    """ Why it failed. Null: it has not. """
    links: InspectionLinks | None | Unset = UNSET
    """ Where it and its job are. """
    result: InspectionResult | None | Unset = UNSET
    """ What was found. Null: nothing yet. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.failure import Failure  # noqa: PLC0415
        from ..models.inspection_links import InspectionLinks  # noqa: PLC0415
        from ..models.inspection_result import InspectionResult  # noqa: PLC0415

        created_at = self.created_at.isoformat()

        file_kept_until = self.file_kept_until.isoformat()

        id = self.id

        job_id = self.job_id

        options = self.options.to_dict()

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
        elif isinstance(self.links, InspectionLinks):
            links = self.links.to_dict()
        else:
            links = self.links

        result: dict[str, Any] | None | Unset
        if isinstance(self.result, Unset):
            result = UNSET
        elif isinstance(self.result, InspectionResult):
            result = self.result.to_dict()
        else:
            result = self.result

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "created_at": created_at,
                "file_kept_until": file_kept_until,
                "id": id,
                "job_id": job_id,
                "options": options,
                "state": state,
            }
        )
        if answered_from is not UNSET:
            field_dict["answered_from"] = answered_from
        if failure is not UNSET:
            field_dict["failure"] = failure
        if links is not UNSET:
            field_dict["links"] = links
        if result is not UNSET:
            field_dict["result"] = result

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.failure import Failure  # noqa: PLC0415
        from ..models.inspected_file import InspectedFile  # noqa: PLC0415
        from ..models.inspection_links import InspectionLinks  # noqa: PLC0415
        from ..models.inspection_result import InspectionResult  # noqa: PLC0415

        d = dict(src_dict)
        created_at = datetime.datetime.fromisoformat(d.pop("created_at"))

        file_kept_until = datetime.datetime.fromisoformat(d.pop("file_kept_until"))

        id = d.pop("id")

        job_id = d.pop("job_id")

        options = InspectedFile.from_dict(d.pop("options"))

        state = JobState(d.pop("state"))

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

        def _parse_links(data: object) -> InspectionLinks | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                links_type_0 = InspectionLinks.from_dict(data)

                return links_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(InspectionLinks | None | Unset, data)

        links = _parse_links(d.pop("links", UNSET))

        def _parse_result(data: object) -> InspectionResult | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                result_type_0 = InspectionResult.from_dict(data)

                return result_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(InspectionResult | None | Unset, data)

        result = _parse_result(d.pop("result", UNSET))

        inspection = cls(
            created_at=created_at,
            file_kept_until=file_kept_until,
            id=id,
            job_id=job_id,
            options=options,
            state=state,
            answered_from=answered_from,
            failure=failure,
            links=links,
            result=result,
        )

        return inspection
