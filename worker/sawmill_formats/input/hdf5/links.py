"""Data of an HDF5 file in other files: read from the user's own disk where links are allowed, never for an upload.

Every linked file is a regular file, next to the one that names it or at an absolute path, and follows the same rules:
its numbers, filters, chunks and sizes are checked before anything is read.
"""

import math
import resource
from collections import defaultdict
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import h5py

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.hdf5 import open_hdf5
from sawmill_formats.hdf5_chunks import check_unpacked
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.hdf5.guard import find
from sawmill_formats.input.hdf5.storage import check_dataset

# Depth of files of a virtual dataset that may name further ones: a scan of scans, and one more.
DEEPEST_SOURCES = 3
# Number of files that this process may open for everything else than sources.
FILES_KEPT_FREE = 64


class _Taken(Protocol):
    """Part of one source that a virtual dataset takes, as h5py describes it."""

    vspace: h5py.h5s.SpaceID
    src_space: h5py.h5s.SpaceID
    file_name: str
    dset_name: str


class LinkedFilesOnDisk:
    """Linked files on the user's own disk; files behind external links stay open as long as the given stack."""

    def __init__(self, files: ExitStack) -> None:
        self.missing: list[UnreadableScan] = []
        self._files = files
        self._open: dict[Path, h5py.File] = {}
        self._paths: dict[Path, None] = {}
        self._depth = 0

    @property
    def paths(self) -> tuple[Path, ...]:
        """Linked files, in the order of their first use."""
        return tuple(self._paths)

    def root(self, beside: h5py.Group | h5py.Dataset, name: str, path: str) -> h5py.Group:
        """Return the root group of the file that an external link names: `linked-file-missing` or `too-large`."""
        target = self.locate(Path(beside.file.filename), name, repr(quoted(path)))
        if target not in self._open:
            _check_number(len(self._open) + 1, repr(quoted(path)))
            self._open[target] = self._files.enter_context(open_hdf5(target))
        return self._open[target]["/"]

    def locate(self, beside: Path, name: str, where: str) -> Path:
        """Find the file that another one names, at its absolute path or next to the other: `linked-file-missing`."""
        file = located(beside, name)
        if file is None:
            raise UnreadableScan(
                "linked-file-missing",
                f"{where} leads to the file {quoted(name)!r}, which is not in the folder {str(beside.parent)!r}; put "
                "it there",
            )
        self._paths[file] = None
        return file

    def stored_bytes(self, where: str, dataset: h5py.Dataset, bounds: Bounds) -> int:
        """Return the bytes stored of a dataset whose data are in other files; all of these files are checked.

        Raises
        ------
        UnreadableScan
            `linked-file-missing`; or for a source that cannot be read, or does not hold the part that is taken.
        """
        if self._depth == DEEPEST_SOURCES:
            raise UnreadableScan(
                "unsupported-storage", f"{where} takes its data through more than {DEEPEST_SOURCES} virtual datasets"
            )
        self._depth += 1
        try:
            return self._of_virtual(where, dataset, bounds) if dataset.is_virtual else self._of_raw(where, dataset)
        finally:
            self._depth -= 1

    def _of_raw(self, where: str, dataset: h5py.Dataset) -> int:
        stored, beside = 0, Path(dataset.file.filename)
        for name, offset, size in dataset.external:
            there = self.locate(beside, name, where).stat().st_size - offset
            stored += max(0, there if size == h5py.h5f.UNLIMITED else min(there, size))
        declared = math.prod(dataset.shape) * dataset.dtype.itemsize
        if stored < declared:
            raise UnreadableScan(
                "truncated-file", f"{where} declares {declared} bytes and the files it lies in hold {stored} of them"
            )
        return stored

    def _of_virtual(self, where: str, dataset: h5py.Dataset, bounds: Bounds) -> int:
        sources: dict[tuple[str, str], list[_Taken]] = defaultdict(list)
        for source in dataset.virtual_sources():
            _check_fixed(where, source)
            sources[source.file_name, source.dset_name].append(source)
        _check_number(len({name for name, _ in sources}), where)
        mapped = sum(source.vspace.get_select_npoints() for each in sources.values() for source in each)
        if mapped < math.prod(dataset.shape):
            raise UnreadableScan(
                "truncated-file",
                f"{where} has {math.prod(dataset.shape)} values and takes {mapped} from other datasets; the rest was "
                "never written",
            )
        return sum(self._of_source(where, dataset, *place, each, bounds) for place, each in sources.items())

    def _of_source(
        self, where: str, dataset: h5py.Dataset, name: str, path: str, mappings: list[_Taken], bounds: Bounds
    ) -> int:
        own = Path(dataset.file.filename)
        place = own if name == "." else self.locate(own, name, where)
        what = f"{where}, in {place.name}: {quoted(path)!r},"
        with open_hdf5(place) as file:
            source = find(file, path, self)
            if not isinstance(source, h5py.Dataset):
                raise UnreadableScan("dataset-missing", f"{what} is no dataset")
            check_dataset(what, source, replace(bounds, linked=self))
            if source.chunks is not None:
                check_unpacked(source)
            for each in mappings:
                _check_inside(what, each, source.shape)
            stored = int(min(source.id.get_storage_size(), file.id.get_filesize()))
            # A source that is itself virtual stores nothing, and was checked by its own sources.
            return stored or math.prod(source.shape) * int(source.dtype.itemsize)


def located(beside: Path, name: str) -> Path | None:
    """Find the regular file that another file names, as the library searches for it; None where there is none."""
    path = Path(name)
    candidates = (path, beside.parent / path.name) if path.is_absolute() else (beside.parent / path,)
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def _check_fixed(where: str, source: _Taken) -> None:
    """Refuse a mapping that grows with its sources, or names them by a pattern."""
    space = source.vspace
    unlimited = space.is_regular_hyperslab() and h5py.h5s.UNLIMITED in {*sum(space.get_regular_hyperslab()[2:], ())}
    if unlimited or "%" in source.file_name + source.dset_name:
        raise UnreadableScan(
            "unsupported-storage",
            f"{where} takes a number of views from {quoted(source.file_name)!r} that is not fixed; write it with the "
            "number of views that there are",
        )


def _check_inside(what: str, source_part: _Taken, shape: tuple[int, ...]) -> None:
    """Refuse a part that exceeds its source: the library would pad it."""
    if source_part.src_space.get_select_type() == h5py.h5s.SEL_ALL:
        enough = math.prod(shape) >= source_part.vspace.get_select_npoints()
    else:
        _, last = source_part.src_space.get_select_bounds()
        enough = len(last) == len(shape) and all(index < length for index, length in zip(last, shape, strict=True))
    if not enough:
        raise UnreadableScan("truncated-file", f"{what} has the shape {shape}, and more is taken of it")


def _check_number(files: int, where: str) -> None:
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[0] - FILES_KEPT_FREE
    if files > most:
        raise UnreadableScan(
            "too-large",
            f"{where} leads to {files} files and {most} may be open at once; raise that number (ulimit -n "
            f"{files + FILES_KEPT_FREE}) or put the data into fewer files",
        )
