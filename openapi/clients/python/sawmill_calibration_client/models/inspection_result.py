from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.file_verdict import FileVerdict
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.failure import Failure
    from ..models.file_part import FilePart
    from ..models.inspected_reading import InspectedReading
    from ..models.missing_part import MissingPart


T = TypeVar("T", bound="InspectionResult")


@_attrs_define
class InspectionResult:
    """All that is said of one file."""

    file: str
    """ The file's name. """
    parts: list[FilePart]
    """ What is in the file. """
    size_bytes: int
    """ Of the file; of a folder, of all files in it. In bytes. """
    verdict: FileVerdict
    """ Whether a file can be read as a scan. """
    format_: None | str | Unset = UNSET
    """ What the file turned out to be; null: nothing that can be read. """
    listing_ended: None | str | Unset = UNSET
    """ Why the list of parts is not complete. Null: it is complete. """
    missing: list[MissingPart] | Unset = UNSET
    """ What the file does not carry. """
    own_kind: None | str | Unset = UNSET
    """ scan, volume or calibration, where this product wrote the file. Null: it did not. """
    parts_left_out: int | Unset = 0
    """ Number of parts beyond the most that are listed. """
    reading: InspectedReading | None | Unset = UNSET
    """ What would be read. Null: nothing can be read. """
    refusal: Failure | None | Unset = UNSET
    """ Why the file would be refused, however it is read. Null: it can be read. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.failure import Failure  # noqa: PLC0415
        from ..models.inspected_reading import InspectedReading  # noqa: PLC0415

        file = self.file

        parts = []
        for parts_item_data in self.parts:
            parts_item = parts_item_data.to_dict()
            parts.append(parts_item)

        size_bytes = self.size_bytes

        verdict = self.verdict.value

        format_: None | str | Unset
        if isinstance(self.format_, Unset):
            format_ = UNSET
        else:
            format_ = self.format_

        listing_ended: None | str | Unset
        if isinstance(self.listing_ended, Unset):
            listing_ended = UNSET
        else:
            listing_ended = self.listing_ended

        missing: list[dict[str, Any]] | Unset = UNSET
        if not isinstance(self.missing, Unset):
            missing = []
            for missing_item_data in self.missing:
                missing_item = missing_item_data.to_dict()
                missing.append(missing_item)

        own_kind: None | str | Unset
        if isinstance(self.own_kind, Unset):
            own_kind = UNSET
        else:
            own_kind = self.own_kind

        parts_left_out = self.parts_left_out

        reading: dict[str, Any] | None | Unset
        if isinstance(self.reading, Unset):
            reading = UNSET
        elif isinstance(self.reading, InspectedReading):
            reading = self.reading.to_dict()
        else:
            reading = self.reading

        refusal: dict[str, Any] | None | Unset
        if isinstance(self.refusal, Unset):
            refusal = UNSET
        elif isinstance(self.refusal, Failure):
            refusal = self.refusal.to_dict()
        else:
            refusal = self.refusal

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "file": file,
                "parts": parts,
                "size_bytes": size_bytes,
                "verdict": verdict,
            }
        )
        if format_ is not UNSET:
            field_dict["format"] = format_
        if listing_ended is not UNSET:
            field_dict["listing_ended"] = listing_ended
        if missing is not UNSET:
            field_dict["missing"] = missing
        if own_kind is not UNSET:
            field_dict["own_kind"] = own_kind
        if parts_left_out is not UNSET:
            field_dict["parts_left_out"] = parts_left_out
        if reading is not UNSET:
            field_dict["reading"] = reading
        if refusal is not UNSET:
            field_dict["refusal"] = refusal

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.failure import Failure  # noqa: PLC0415
        from ..models.file_part import FilePart  # noqa: PLC0415
        from ..models.inspected_reading import InspectedReading  # noqa: PLC0415
        from ..models.missing_part import MissingPart  # noqa: PLC0415

        d = dict(src_dict)
        file = d.pop("file")

        parts = []
        _parts = d.pop("parts")
        for parts_item_data in _parts:
            parts_item = FilePart.from_dict(parts_item_data)

            parts.append(parts_item)

        size_bytes = d.pop("size_bytes")

        verdict = FileVerdict(d.pop("verdict"))

        def _parse_format_(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        format_ = _parse_format_(d.pop("format", UNSET))

        def _parse_listing_ended(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        listing_ended = _parse_listing_ended(d.pop("listing_ended", UNSET))

        _missing = d.pop("missing", UNSET)
        missing: list[MissingPart] | Unset = UNSET
        if _missing is not UNSET:
            missing = []
            for missing_item_data in _missing:
                missing_item = MissingPart.from_dict(missing_item_data)

                missing.append(missing_item)

        def _parse_own_kind(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        own_kind = _parse_own_kind(d.pop("own_kind", UNSET))

        parts_left_out = d.pop("parts_left_out", UNSET)

        def _parse_reading(data: object) -> InspectedReading | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                reading_type_0 = InspectedReading.from_dict(data)

                return reading_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(InspectedReading | None | Unset, data)

        reading = _parse_reading(d.pop("reading", UNSET))

        def _parse_refusal(data: object) -> Failure | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                refusal_type_0 = Failure.from_dict(data)

                return refusal_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(Failure | None | Unset, data)

        refusal = _parse_refusal(d.pop("refusal", UNSET))

        inspection_result = cls(
            file=file,
            parts=parts,
            size_bytes=size_bytes,
            verdict=verdict,
            format_=format_,
            listing_ended=listing_ended,
            missing=missing,
            own_kind=own_kind,
            parts_left_out=parts_left_out,
            reading=reading,
            refusal=refusal,
        )

        return inspection_result
