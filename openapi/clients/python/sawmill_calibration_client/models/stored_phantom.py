from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.phantom_state import PhantomState
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.phantom_drawing import PhantomDrawing


T = TypeVar("T", bound="StoredPhantom")


@_attrs_define
class StoredPhantom:
    """A phantom that scans can be calibrated against."""

    built_in: bool
    """ Whether it came with the software, and so cannot be deleted. """
    created_at: datetime.datetime
    """ When it was created, RFC 3339, UTC. """
    drawing: None | PhantomDrawing
    """ Null until a picture has been traced. """
    id: str
    """ The resource's id, which the service gives. """
    name: str
    """ What people call it. """
    state: PhantomState
    """ A picture is traced by a job; everything else is ready at once. """
    job_id: None | str | Unset = UNSET
    """ Id of the job that traces its picture. Null: it was drawn. """
    reason: None | str | Unset = UNSET
    """ Why a picture was refused, in one sentence. Null: it was not. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.phantom_drawing import PhantomDrawing  # noqa: PLC0415

        built_in = self.built_in

        created_at = self.created_at.isoformat()

        drawing: dict[str, Any] | None
        if isinstance(self.drawing, PhantomDrawing):
            drawing = self.drawing.to_dict()
        else:
            drawing = self.drawing

        id = self.id

        name = self.name

        state = self.state.value

        job_id: None | str | Unset
        if isinstance(self.job_id, Unset):
            job_id = UNSET
        else:
            job_id = self.job_id

        reason: None | str | Unset
        if isinstance(self.reason, Unset):
            reason = UNSET
        else:
            reason = self.reason

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "built_in": built_in,
                "created_at": created_at,
                "drawing": drawing,
                "id": id,
                "name": name,
                "state": state,
            }
        )
        if job_id is not UNSET:
            field_dict["job_id"] = job_id
        if reason is not UNSET:
            field_dict["reason"] = reason

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.phantom_drawing import PhantomDrawing  # noqa: PLC0415

        d = dict(src_dict)
        built_in = d.pop("built_in")

        created_at = datetime.datetime.fromisoformat(d.pop("created_at"))

        def _parse_drawing(data: object) -> None | PhantomDrawing:
            if data is None:
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                drawing_type_0 = PhantomDrawing.from_dict(data)

                return drawing_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | PhantomDrawing, data)

        drawing = _parse_drawing(d.pop("drawing"))

        id = d.pop("id")

        name = d.pop("name")

        state = PhantomState(d.pop("state"))

        def _parse_job_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        job_id = _parse_job_id(d.pop("job_id", UNSET))

        def _parse_reason(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        reason = _parse_reason(d.pop("reason", UNSET))

        stored_phantom = cls(
            built_in=built_in,
            created_at=created_at,
            drawing=drawing,
            id=id,
            name=name,
            state=state,
            job_id=job_id,
            reason=reason,
        )

        return stored_phantom
