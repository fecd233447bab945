from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="UploadAsk")


@_attrs_define
class UploadAsk:
    """A file that is to be sent in parts."""

    size_bytes: int
    """ The length of the whole file, in bytes. """
    name: None | str | Unset = UNSET
    """ What the file is called. """
    sha256: None | str | Unset = UNSET
    """ Of the whole file, in hexadecimal digits: what comes out otherwise is refused. """

    def to_dict(self) -> dict[str, Any]:
        size_bytes = self.size_bytes

        name: None | str | Unset
        if isinstance(self.name, Unset):
            name = UNSET
        else:
            name = self.name

        sha256: None | str | Unset
        if isinstance(self.sha256, Unset):
            sha256 = UNSET
        else:
            sha256 = self.sha256

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "size_bytes": size_bytes,
            }
        )
        if name is not UNSET:
            field_dict["name"] = name
        if sha256 is not UNSET:
            field_dict["sha256"] = sha256

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        size_bytes = d.pop("size_bytes")

        def _parse_name(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        name = _parse_name(d.pop("name", UNSET))

        def _parse_sha256(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        sha256 = _parse_sha256(d.pop("sha256", UNSET))

        upload_ask = cls(
            size_bytes=size_bytes,
            name=name,
            sha256=sha256,
        )

        return upload_ask
