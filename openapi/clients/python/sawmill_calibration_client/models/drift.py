from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.job_state import JobState
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.drift_links import DriftLinks
    from ..models.drift_options import DriftOptions
    from ..models.drift_result import DriftResult
    from ..models.failure import Failure


T = TypeVar("T", bound="Drift")


@_attrs_define
class Drift:
    """A drift check as it stands."""

    calibration_id: str
    """ Id of the calibration that it is compared with. """
    created_at: datetime.datetime
    """ When it was created, RFC 3339, UTC. """
    id: str
    """ The resource's id, which the service gives. """
    job_id: str
    """ Id of the job that computes it. """
    options: DriftOptions
    """ Which part of the scan is looked at. """
    scan_id: str
    """ Id of the scan that is looked at. """
    scanner_id: str
    """ Id of the scanner. """
    state: JobState
    """ A job's life: queued, running, then one of the three ends. """
    answered_from: None | str | Unset = UNSET
    """ Id of the earlier one of its kind whose result it has: computed of the same input, with the same parameters
    and the same version of the software. The seconds in the result are those of that computation. Null: it was
    computed itself, or has no result. """
    failure: Failure | None | Unset = UNSET
    """ Why it failed. Null: it has not. """
    links: DriftLinks | None | Unset = UNSET
    """ Where it is, and what it refers to. """
    result: DriftResult | None | Unset = UNSET
    """ The answer. Null: there is none yet. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.drift_links import DriftLinks  # noqa: PLC0415
        from ..models.drift_result import DriftResult  # noqa: PLC0415
        from ..models.failure import Failure  # noqa: PLC0415

        calibration_id = self.calibration_id

        created_at = self.created_at.isoformat()

        id = self.id

        job_id = self.job_id

        options = self.options.to_dict()

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
        elif isinstance(self.links, DriftLinks):
            links = self.links.to_dict()
        else:
            links = self.links

        result: dict[str, Any] | None | Unset
        if isinstance(self.result, Unset):
            result = UNSET
        elif isinstance(self.result, DriftResult):
            result = self.result.to_dict()
        else:
            result = self.result

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "calibration_id": calibration_id,
                "created_at": created_at,
                "id": id,
                "job_id": job_id,
                "options": options,
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
        if result is not UNSET:
            field_dict["result"] = result

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.drift_links import DriftLinks  # noqa: PLC0415
        from ..models.drift_options import DriftOptions  # noqa: PLC0415
        from ..models.drift_result import DriftResult  # noqa: PLC0415
        from ..models.failure import Failure  # noqa: PLC0415

        d = dict(src_dict)
        calibration_id = d.pop("calibration_id")

        created_at = datetime.datetime.fromisoformat(d.pop("created_at"))

        id = d.pop("id")

        job_id = d.pop("job_id")

        options = DriftOptions.from_dict(d.pop("options"))

        scan_id = d.pop("scan_id")

        scanner_id = d.pop("scanner_id")

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

        def _parse_links(data: object) -> DriftLinks | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                links_type_0 = DriftLinks.from_dict(data)

                return links_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(DriftLinks | None | Unset, data)

        links = _parse_links(d.pop("links", UNSET))

        def _parse_result(data: object) -> DriftResult | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                result_type_0 = DriftResult.from_dict(data)

                return result_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(DriftResult | None | Unset, data)

        result = _parse_result(d.pop("result", UNSET))

        drift = cls(
            calibration_id=calibration_id,
            created_at=created_at,
            id=id,
            job_id=job_id,
            options=options,
            scan_id=scan_id,
            scanner_id=scanner_id,
            state=state,
            answered_from=answered_from,
            failure=failure,
            links=links,
            result=result,
        )

        return drift
