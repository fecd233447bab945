"""ZIP archives of TIFF files, one or more views each, flat and dark fields recognised by their names."""

from contextlib import AbstractContextManager, ExitStack
from functools import partial
from io import BytesIO
from pathlib import Path
from zipfile import ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.archives import members, opened
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.contents import FileContents
from sawmill_formats.input.npy import read_npz
from sawmill_formats.input.tiff.pages import TiffPages, open_pages
from sawmill_formats.input.tiff.several_files import TiffFile, checked_files, image_kind, is_tiff, natural_key, stacked
from sawmill_formats.input.wanted import FieldKind, Wanted
from sawmill_vocabulary.reading_messages import ReadingMessage

WHAT = "the archive"
KINDS = {"flat": FieldKind.FLATS, "dark": FieldKind.DARKS}


def read_zip(path: Path, selection: Wanted, bounds: Bounds, files: ExitStack) -> FileContents:
    """Read a NPZ file or a ZIP of TIFF files, as the members' names show; a ZIP of TIFFs stays open for its views.

    Raises
    ------
    UnreadableScan
        When the archive is unsafe to unpack, or holds neither.
    """
    archive, size = files.enter_context(opened(path)), path.stat().st_size
    infos = members(archive, size, bounds.array)
    if is_npz(infos):
        return read_npz(archive, members(archive, size, bounds.piece), selection, bounds.piece)
    if selection.dataset is not None:
        raise UnreadableScan(
            "contradiction", f"a ZIP of TIFFs has no named arrays; leave out dataset {quoted(selection.dataset)!r}"
        )
    return _read_tiffs(archive, infos, selection, bounds)


def is_npz(infos: list[ZipInfo]) -> bool:
    """Return whether an archive holds arrays and nothing else."""
    return bool(infos) and all(info.filename.endswith(".npy") for info in infos)


def _read_tiffs(archive: ZipFile, infos: list[ZipInfo], selection: Wanted, bounds: Bounds) -> FileContents:
    images = sorted((info for info in infos if is_tiff(info.filename)), key=lambda info: natural_key(info.filename))
    kinds: dict[FieldKind | None, list[TiffFile]] = {None: [], FieldKind.FLATS: [], FieldKind.DARKS: []}
    for info in images:
        file = TiffFile(info.filename, info.compress_size, partial(_unpacked, archive, info))
        kinds[KINDS.get(image_kind(info.filename))].append(file)
    flats, darks = (_fields(kinds[kind], bounds.whole) for kind in FieldKind)
    views = kinds[None] or (kinds[selection.fields] if selection.fields else [])
    if not infos:
        raise UnreadableScan("unknown-format", "the archive holds no files; pack the views as .tif files")
    if not views:
        fields = len(kinds[FieldKind.FLATS]) + len(kinds[FieldKind.DARKS])
        raise UnreadableScan(
            "unknown-format",
            f"the archive holds no TIFF files of views, but {fields} of flat and dark fields and {len(infos) - fields} "
            "other files; pack the views as .tif files whose names begin neither with flat nor with dark",
        )
    checked = checked_files(WHAT, views, bounds, rows_missing=True)
    ignored = len(infos) - len(images)
    remarks = [ReadingMessage.OTHER_FILES(files=ignored)] if ignored else []
    rows = max(member.shape[1] for member in checked)
    if any(member.shape[1] < rows for member in checked):
        rows = max(rows, 0 if flats is None else flats.shape[1])
        remarks.append(ReadingMessage.FEWER_ROWS(rows=rows))
    return FileContents("zip-of-tiffs", stacked(checked, rows, bounds), flats, darks, remarks=tuple(remarks))


def _unpacked(archive: ZipFile, info: ZipInfo, bounds: Bounds) -> AbstractContextManager[TiffPages]:
    if info.file_size > bounds.piece:
        raise UnreadableScan(
            "too-large",
            f"{quoted(info.filename)!r} unpacks to {info.file_size} bytes and at most {bounds.piece} are allowed "
            "or free; pack fewer views into one file",
        )
    data = archive.read(info)
    return open_pages(BytesIO(data), repr(quoted(info.filename)), len(data), bounds)


def _fields(files: list[TiffFile], bounds: Bounds) -> NDArray[np.float32] | None:
    if not files:
        return None
    checked = checked_files(WHAT, files, bounds)
    fields = stacked(checked, checked[0].shape[1], bounds)
    return fields.read(slice(0, fields.shape[0]), slice(0, fields.shape[1]))
