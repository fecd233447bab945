from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="FilePart")


@_attrs_define
class FilePart:
    """A group, dataset, link, variable, array, page or file, from its header; of several that are alike, all."""

    kind: str
    """ What it is, as a group, a dataset, a link, an array or a page. """
    name: str
    """ Where it is; of several that are alike, the first and the last. """
    compression: None | str | Unset = UNSET
    """ The filters through which it is stored; null: none. """
    count: int | Unset = 1
    """ The number of parts, which are alike but for the numbers in their names. """
    leads_to: None | str | Unset = UNSET
    """ Where a link leads, or where data lie that are elsewhere. """
    shape: list[int] | None | Unset = UNSET
    """ In the axis order of the file. """
    stored_bytes: int | None | Unset = UNSET
    """ Bytes that it takes in the file. Null: not known from its header. """
    type_: None | str | Unset = UNSET
    """ Of its numbers, or what it is instead. """
    unit: None | str | Unset = UNSET
    """ Its unit, as the file states it. Null: the file states none. """

    def to_dict(self) -> dict[str, Any]:
        kind = self.kind

        name = self.name

        compression: None | str | Unset
        if isinstance(self.compression, Unset):
            compression = UNSET
        else:
            compression = self.compression

        count = self.count

        leads_to: None | str | Unset
        if isinstance(self.leads_to, Unset):
            leads_to = UNSET
        else:
            leads_to = self.leads_to

        shape: list[int] | None | Unset
        if isinstance(self.shape, Unset):
            shape = UNSET
        elif isinstance(self.shape, list):
            shape = self.shape

        else:
            shape = self.shape

        stored_bytes: int | None | Unset
        if isinstance(self.stored_bytes, Unset):
            stored_bytes = UNSET
        else:
            stored_bytes = self.stored_bytes

        type_: None | str | Unset
        if isinstance(self.type_, Unset):
            type_ = UNSET
        else:
            type_ = self.type_

        unit: None | str | Unset
        if isinstance(self.unit, Unset):
            unit = UNSET
        else:
            unit = self.unit

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "kind": kind,
                "name": name,
            }
        )
        if compression is not UNSET:
            field_dict["compression"] = compression
        if count is not UNSET:
            field_dict["count"] = count
        if leads_to is not UNSET:
            field_dict["leads_to"] = leads_to
        if shape is not UNSET:
            field_dict["shape"] = shape
        if stored_bytes is not UNSET:
            field_dict["stored_bytes"] = stored_bytes
        if type_ is not UNSET:
            field_dict["type"] = type_
        if unit is not UNSET:
            field_dict["unit"] = unit

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        kind = d.pop("kind")

        name = d.pop("name")

        def _parse_compression(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        compression = _parse_compression(d.pop("compression", UNSET))

        count = d.pop("count", UNSET)

        def _parse_leads_to(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        leads_to = _parse_leads_to(d.pop("leads_to", UNSET))

        def _parse_shape(data: object) -> list[int] | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, list):
                    raise TypeError()
                shape_type_0 = cast(list[int], data)

                return shape_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(list[int] | None | Unset, data)

        shape = _parse_shape(d.pop("shape", UNSET))

        def _parse_stored_bytes(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        stored_bytes = _parse_stored_bytes(d.pop("stored_bytes", UNSET))

        def _parse_type_(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        type_ = _parse_type_(d.pop("type", UNSET))

        def _parse_unit(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        unit = _parse_unit(d.pop("unit", UNSET))

        file_part = cls(
            kind=kind,
            name=name,
            compression=compression,
            count=count,
            leads_to=leads_to,
            shape=shape,
            stored_bytes=stored_bytes,
            type_=type_,
            unit=unit,
        )

        return file_part
