from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.upload_state import UploadState

T = TypeVar("T", bound="Upload")


@_attrs_define
class Upload:
    """An upload that can be resumed."""

    created_at: datetime.datetime
    """ When it was created, RFC 3339, UTC. """
    expires_at: datetime.datetime
    """ When it is removed; each part that comes puts that off. """
    id: str
    """ The resource's id, which the service gives. """
    name: None | str
    """ What the file is called; null: not given. """
    offset_bytes: int
    """ The number of bytes that are on the disk: the next part begins there. """
    sha256: None | str
    """ Of the whole file: as given, or computed once it is complete; null before. """
    size_bytes: int
    """ The length of the whole file, in bytes. """
    state: UploadState
    """ How far an upload is. """
    used_by: None | str
    """ The path of what was made of it; null: nothing yet. """

    def to_dict(self) -> dict[str, Any]:
        created_at = self.created_at.isoformat()

        expires_at = self.expires_at.isoformat()

        id = self.id

        name: None | str
        name = self.name

        offset_bytes = self.offset_bytes

        sha256: None | str
        sha256 = self.sha256

        size_bytes = self.size_bytes

        state = self.state.value

        used_by: None | str
        used_by = self.used_by

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "created_at": created_at,
                "expires_at": expires_at,
                "id": id,
                "name": name,
                "offset_bytes": offset_bytes,
                "sha256": sha256,
                "size_bytes": size_bytes,
                "state": state,
                "used_by": used_by,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        created_at = datetime.datetime.fromisoformat(d.pop("created_at"))

        expires_at = datetime.datetime.fromisoformat(d.pop("expires_at"))

        id = d.pop("id")

        def _parse_name(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        name = _parse_name(d.pop("name"))

        offset_bytes = d.pop("offset_bytes")

        def _parse_sha256(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        sha256 = _parse_sha256(d.pop("sha256"))

        size_bytes = d.pop("size_bytes")

        state = UploadState(d.pop("state"))

        def _parse_used_by(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        used_by = _parse_used_by(d.pop("used_by"))

        upload = cls(
            created_at=created_at,
            expires_at=expires_at,
            id=id,
            name=name,
            offset_bytes=offset_bytes,
            sha256=sha256,
            size_bytes=size_bytes,
            state=state,
            used_by=used_by,
        )

        return upload
