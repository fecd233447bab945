"""ZIP archives of TIFF files, one or more views each, flat and dark fields recognised by their names."""

from contextlib import AbstractContextManager, ExitStack
from functools import partial
from io import BytesIO
from pathlib import Path
from zipfile import ZipFile, ZipInfo

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.archives import members, opened
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.contents import FileContents
from sawmill_formats.input.npy import read_npz
from sawmill_formats.input.tiff.pages import TiffPages, open_pages
from sawmill_formats.input.tiff.several_files import TiffFile, is_tiff, read_files
from sawmill_formats.input.wanted import Wanted


def read_zip(path: Path, selection: Wanted, bounds: Bounds, files: ExitStack) -> FileContents:
    """Read a NPZ file or a ZIP of TIFF files, as the members' names show; a ZIP of TIFFs stays open for its views."""
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
    if not infos:
        raise UnreadableScan("unknown-format", "the archive holds no files; pack the views as .tif files")
    images = [
        TiffFile(info.filename, info.compress_size, partial(_unpacked, archive, info))
        for info in infos
        if is_tiff(info.filename)
    ]
    others = [info.filename for info in infos if not is_tiff(info.filename)]
    return read_files("zip-of-tiffs", images, others, archive.open, selection, bounds, rows_missing=True)


def _unpacked(archive: ZipFile, info: ZipInfo, bounds: Bounds) -> AbstractContextManager[TiffPages]:
    if info.file_size > bounds.piece:
        raise UnreadableScan(
            "too-large",
            f"{quoted(info.filename)!r} unpacks to {info.file_size} bytes and at most {bounds.piece} are allowed "
            "or free; pack fewer views into one file",
        )
    data = archive.read(info)
    return open_pages(BytesIO(data), repr(quoted(info.filename)), len(data), bounds)
