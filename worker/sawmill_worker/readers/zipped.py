"""ZIP archives of TIFF files, one or more views each, flat and dark fields recognised by their names."""

import math
import re
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path, PurePosixPath
from zipfile import ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.files.errors import UnreadableScan, quoted
from sawmill_worker.readers.archives import members, opened
from sawmill_worker.readers.arrays import Bounds, check_size
from sawmill_worker.readers.contents import FileContents, Projections
from sawmill_worker.readers.npy import read_npz
from sawmill_worker.readers.tiff import TiffPages, open_pages

TIFF_SUFFIXES = frozenset({".tif", ".tiff"})
# Views of which one has less than this share of the rows of another are not views of one log.
LEAST_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class _Member:
    """A TIFF file of the archive, unpacked when its pages are asked for."""

    info: ZipInfo
    shape: tuple[int, int, int]


def read_zip(path: Path, dataset: str | None, bounds: Bounds, files: ExitStack) -> FileContents:
    """Read a NPZ file or a ZIP of TIFF files, as the members' names show; the latter stays open for its views.

    Raises
    ------
    UnreadableScan
        When the archive is unsafe to unpack, or holds neither.
    """
    archive, size = files.enter_context(opened(path)), path.stat().st_size
    infos = members(archive, size, bounds.array)
    if infos and all(info.filename.endswith(".npy") for info in infos):
        return read_npz(archive, members(archive, size, bounds.piece), dataset, bounds.piece)
    if dataset is not None:
        raise UnreadableScan(
            "contradiction", f"a ZIP of TIFFs has no named arrays; leave out dataset {quoted(dataset)!r}"
        )
    return _read_tiffs(archive, infos, bounds)


def _read_tiffs(archive: ZipFile, infos: list[ZipInfo], bounds: Bounds) -> FileContents:
    images = sorted((info for info in infos if _is_tiff(info.filename)), key=lambda info: natural_key(info.filename))
    kinds: dict[str, list[ZipInfo]] = {"view": [], "flat": [], "dark": []}
    for info in images:
        kinds[image_kind(info.filename)].append(info)
    if not kinds["view"]:
        raise UnreadableScan("unknown-format", "the archive holds no TIFF files of views; pack the views as .tif files")
    views = _checked_members(archive, kinds["view"], bounds, rows_missing=True)
    flats, darks = (_fields(archive, kinds[kind], bounds.whole) for kind in ("flat", "dark"))
    ignored = len(infos) - len(images)
    remarks = [f"{ignored} files that are no TIFFs were ignored."] if ignored else []
    rows = max(member.shape[1] for member in views)
    if any(member.shape[1] < rows for member in views):
        rows = max(rows, 0 if flats is None else flats.shape[1])
        remarks.append(f"Views of fewer than {rows} rows were read as lacking rows at their end.")
    return FileContents(
        "zip-of-tiffs", _projections(archive, views, rows, bounds), flats, darks, remarks=tuple(remarks)
    )


def image_kind(name: str) -> str:
    """`flat` or `dark` where a folder or the file is so called or begins so, else `view`."""
    for part in PurePosixPath(name.lower()).parts:
        for kind in ("flat", "dark"):
            if part.startswith(kind):
                return kind
    return "view"


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sort view-2 before view-10."""
    return [
        (0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name.lower()) if part
    ]


def _is_tiff(name: str) -> bool:
    path = PurePosixPath(name)
    # macOS packs a hidden twin beside each file.
    return path.suffix.lower() in TIFF_SUFFIXES and not path.name.startswith(".") and "__MACOSX" not in path.parts


def _checked_members(
    archive: ZipFile, infos: list[ZipInfo], bounds: Bounds, *, rows_missing: bool = False
) -> list[_Member]:
    """Each file's pages checked, all of one size; views may lack rows."""
    found: list[_Member] = []
    before = stored = 0
    for info in infos:
        if info.file_size > bounds.piece:
            raise UnreadableScan(
                "too-large",
                f"{quoted(info.filename)!r} unpacks to {info.file_size} bytes and at most {bounds.piece} are allowed "
                "or free; pack fewer views into one file",
            )
        with _unpacked(archive, info, replace(bounds, array=bounds.array - before)) as pages:
            member = _Member(info, pages.shape)
        _check_like(member, (found or [member])[0], rows_missing=rows_missing)
        found.append(member)
        before += 4 * math.prod(member.shape)
        stored += info.compress_size
    check_size("the archive", (before // 4,), 4, stored_bytes=stored, max_bytes=bounds.array)
    return found


def _unpacked(archive: ZipFile, info: ZipInfo, bounds: Bounds) -> AbstractContextManager[TiffPages]:
    data = archive.read(info)
    return open_pages(BytesIO(data), repr(quoted(info.filename)), len(data), bounds)


def _check_like(member: _Member, first: _Member, *, rows_missing: bool) -> None:
    (_, rows, cells), (_, rows_before, cells_before) = member.shape, first.shape
    alike = rows == rows_before or (rows_missing and LEAST_SHARE * max(rows, rows_before) <= min(rows, rows_before))
    if cells != cells_before or not alike:
        raise UnreadableScan(
            "wrong-shape",
            f"{quoted(member.info.filename)!r} has (rows, detector) = {member.shape[1:]} and the files before it "
            f"{first.shape[1:]}; all must be of one size",
        )


def _projections(archive: ZipFile, files: list[_Member], rows: int, bounds: Bounds) -> Projections:
    """All pages of the files, those of fewer rows filled with NaN at their end."""
    ends = np.cumsum([member.shape[0] for member in files])
    cells = files[0].shape[2]

    def read(views: slice, wanted: slice) -> NDArray[np.float32]:
        block = np.full((views.stop - views.start, wanted.stop - wanted.start, cells), np.nan, np.float32)
        for member, end in zip(files, ends.tolist(), strict=True):
            first = end - member.shape[0]
            start, stop, end_row = max(first, views.start), min(end, views.stop), min(wanted.stop, member.shape[1])
            if start < stop and wanted.start < end_row:
                with _unpacked(archive, member.info, bounds) as pages:
                    part = pages.read(slice(start - first, stop - first), slice(wanted.start, end_row))
                block[start - views.start : stop - views.start, : end_row - wanted.start] = part
        return block

    return Projections((int(ends[-1]), rows, cells), read, (max(member.shape[0] for member in files), rows))


def _fields(archive: ZipFile, infos: list[ZipInfo], bounds: Bounds) -> NDArray[np.float32] | None:
    if not infos:
        return None
    files = _checked_members(archive, infos, bounds)
    fields = _projections(archive, files, files[0].shape[1], bounds)
    return fields.read(slice(0, fields.shape[0]), slice(0, fields.shape[1]))
