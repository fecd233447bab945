"""ZIP archives of TIFF files, one or more views each, flat and dark fields told by their names."""

import re
from io import BytesIO
from pathlib import Path, PurePosixPath
from zipfile import ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from worker.formats.archives import members
from worker.formats.contents import FileContents
from worker.formats.errors import UnreadableScan, quoted
from worker.formats.npy import read_npz
from worker.formats.tiff import read_pages

TIFF_SUFFIXES = frozenset({".tif", ".tiff"})
# Views whose heights differ by more than this factor are no views of one log.
MOST_LOST = 0.5


def read_zip(path: Path, dataset: str | None, max_bytes: int) -> FileContents:
    """Read a NPZ file or a ZIP of TIFF files, whichever the members' names say.

    Raises
    ------
    UnreadableScan
        When the archive is unsafe to unpack, or holds neither.
    """
    with ZipFile(path) as archive:
        infos = members(archive, max_bytes)
        if infos and all(info.filename.endswith(".npy") for info in infos):
            return read_npz(path, dataset, max_bytes)
        if dataset is not None:
            raise UnreadableScan(
                "contradiction", f"a ZIP of TIFFs has no named arrays; leave out dataset {quoted(dataset)!r}"
            )
        return _read_tiffs(archive, infos, max_bytes)


def _read_tiffs(archive: ZipFile, infos: list[ZipInfo], max_bytes: int) -> FileContents:
    frames = sorted((info for info in infos if _is_tiff(info.filename)), key=lambda info: natural_key(info.filename))
    kinds: dict[str, list[ZipInfo]] = {"view": [], "flat": [], "dark": []}
    for info in frames:
        kinds[frame_kind(info.filename)].append(info)
    if not kinds["view"]:
        raise UnreadableScan("unknown-format", "the archive holds no TIFF files of views; pack the views as .tif files")
    views = _read_frames(archive, kinds["view"], max_bytes, rows_lost=True)
    flats, darks = (_fields(_read_frames(archive, kinds[kind], max_bytes)) for kind in ("flat", "dark"))
    ignored = len(infos) - len(frames)
    remarks = [f"{ignored} files that are no TIFFs were ignored."] if ignored else []
    if len({stack.shape[1] for stack in views}) > 1:
        rows = max(stack.shape[1] for stack in (*views, *([] if flats is None else [flats])))
        views = [_with_missing_rows(stack, rows) for stack in views]
        remarks.append(f"Views of fewer than {rows} rows were read as lacking rows at the bottom.")
    return FileContents("zip-of-tiffs", np.concatenate(views), flats, darks, remarks=tuple(remarks))


def frame_kind(name: str) -> str:
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


def _read_frames(
    archive: ZipFile, infos: list[ZipInfo], max_bytes: int, *, rows_lost: bool = False
) -> list[NDArray[np.float32]]:
    """Each file's pages, all of one size; views may have lost rows."""
    stacks: list[NDArray[np.float32]] = []
    for info in infos:
        data = archive.read(info)
        name = repr(quoted(info.filename))
        stack = read_pages(BytesIO(data), name, len(data), max_bytes - sum(s.nbytes for s in stacks))
        first = (stacks or [stack])[0]
        rows, rows_before = stack.shape[1], first.shape[1]
        alike = rows == rows_before or (rows_lost and MOST_LOST * max(rows, rows_before) <= min(rows, rows_before))
        if stack.shape[2] != first.shape[2] or not alike:
            raise UnreadableScan(
                "wrong-shape",
                f"{name} has (rows, detector) = {stack.shape[1:]} and the files before it {first.shape[1:]}; "
                "all must be of one size",
            )
        stacks.append(stack)
    return stacks


def _fields(stacks: list[NDArray[np.float32]]) -> NDArray[np.float32] | None:
    return np.concatenate(stacks) if stacks else None


def _with_missing_rows(views: NDArray[np.float32], rows: int) -> NDArray[np.float32]:
    lost = ((0, 0), (0, rows - views.shape[1]), (0, 0))
    return np.pad(views, lost, constant_values=np.nan)
