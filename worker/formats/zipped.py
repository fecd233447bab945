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
    ignored = len(infos) - len(frames)
    return FileContents(
        format="zip-of-tiffs",
        projections=_read_frames(archive, kinds["view"], max_bytes),
        flats=_read_frames(archive, kinds["flat"], max_bytes) if kinds["flat"] else None,
        darks=_read_frames(archive, kinds["dark"], max_bytes) if kinds["dark"] else None,
        remarks=(f"{ignored} files that are no TIFFs were ignored.",) if ignored else (),
    )


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


def _read_frames(archive: ZipFile, infos: list[ZipInfo], max_bytes: int) -> NDArray[np.float32]:
    stacks: list[NDArray[np.float32]] = []
    for info in infos:
        data = archive.read(info)
        name = repr(quoted(info.filename))
        stack = read_pages(BytesIO(data), name, len(data), max_bytes - sum(s.nbytes for s in stacks))
        if stack.shape[1:] != (stacks or [stack])[0].shape[1:]:
            raise UnreadableScan(
                "wrong-shape",
                f"{name} has (rows, detector) = {stack.shape[1:]} and the files before it {stacks[0].shape[1:]}; "
                "all must be of one size",
            )
        stacks.append(stack)
    return np.concatenate(stacks)
