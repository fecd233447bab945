from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.data_kind import DataKind
from ..types import UNSET, Unset

T = TypeVar("T", bound="InspectedFile")


@_attrs_define
class InspectedFile:
    """The file beside them."""

    sha256: str
    """ SHA-256 of the file, in hexadecimal digits. """
    size_bytes: int
    """ Size of the file, bytes. """
    angles_deg: None | str | Unset = UNSET
    """ START:STEP in degrees, or every view's angle separated by commas; where the file carries none. """
    data: DataKind | None | Unset = UNSET
    """ What the numbers are; null: not given. """
    dataset: None | str | Unset = UNSET
    """ Path or variable of the projections, where the file holds several. Null: not given. """
    name: str | Unset = "file"
    """ The name under which it was sent. """

    def to_dict(self) -> dict[str, Any]:
        sha256 = self.sha256

        size_bytes = self.size_bytes

        angles_deg: None | str | Unset
        if isinstance(self.angles_deg, Unset):
            angles_deg = UNSET
        else:
            angles_deg = self.angles_deg

        data: None | str | Unset
        if isinstance(self.data, Unset):
            data = UNSET
        elif isinstance(self.data, DataKind):
            data = self.data.value
        else:
            data = self.data

        dataset: None | str | Unset
        if isinstance(self.dataset, Unset):
            dataset = UNSET
        else:
            dataset = self.dataset

        name = self.name

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "sha256": sha256,
                "size_bytes": size_bytes,
            }
        )
        if angles_deg is not UNSET:
            field_dict["angles_deg"] = angles_deg
        if data is not UNSET:
            field_dict["data"] = data
        if dataset is not UNSET:
            field_dict["dataset"] = dataset
        if name is not UNSET:
            field_dict["name"] = name

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        sha256 = d.pop("sha256")

        size_bytes = d.pop("size_bytes")

        def _parse_angles_deg(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        angles_deg = _parse_angles_deg(d.pop("angles_deg", UNSET))

        def _parse_data(data: object) -> DataKind | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                data_type_0 = DataKind(data)

                return data_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(DataKind | None | Unset, data)

        data = _parse_data(d.pop("data", UNSET))

        def _parse_dataset(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        dataset = _parse_dataset(d.pop("dataset", UNSET))

        name = d.pop("name", UNSET)

        inspected_file = cls(
            sha256=sha256,
            size_bytes=size_bytes,
            angles_deg=angles_deg,
            data=data,
            dataset=dataset,
            name=name,
        )

        return inspected_file
