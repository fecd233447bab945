"""HDF5 files of any layout: its recognition, and plain datasets where there is none (MATLAB 7.3 files among them)."""

from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats import nxtomo
from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.hdf5 import open_hdf5
from sawmill_formats.input.arrays import Bounds, LinkedFiles
from sawmill_formats.input.contents import FileAngles, FileContents, Projections, Wanted, in_order
from sawmill_formats.input.hdf5 import fields
from sawmill_formats.input.hdf5.exchange import EXCHANGE_DATA, read_exchange
from sawmill_formats.input.hdf5.guard import attribute, attribute_text, datasets, find, name_of, read_values
from sawmill_formats.input.hdf5.nxtomo import find_entries, read_nxtomo
from sawmill_formats.input.hdf5.storage import check_dataset
from sawmill_formats.input.mat5 import MATLAB_NUMBERS, check_matlab_class
from sawmill_formats.input.named_arrays import LONGEST_TEXT, ArrayInfo, NamedArrays, read_named_arrays
from sawmill_vocabulary.reading_messages import ReadingMessage


def read_hdf5(path: Path, selection: Wanted, bounds: Bounds, files: ExitStack) -> FileContents:
    """Read an HDF5 file of any layout, which stays open for its projections."""
    file = files.enter_context(open_hdf5(path))
    try:
        return _read(file, selection, bounds)
    except UnreadableScan as error:
        if bounds.linked is None or not bounds.linked.missing or error.code != "dataset-missing":
            raise
        raise bounds.linked.missing[0] from error


def _read(file: h5py.File, selection: Wanted, bounds: Bounds) -> FileContents:
    entry = _choose_entry(file, selection.dataset, bounds.linked)
    if entry is not None:
        return read_nxtomo(entry, bounds, selection)
    if (
        isinstance(find(file, EXCHANGE_DATA, bounds.linked), h5py.Dataset)
        and (selection.dataset or EXCHANGE_DATA).strip("/") == EXCHANGE_DATA
    ):
        return read_exchange(file, bounds, selection)
    return _read_plain(file, selection, bounds)


def _choose_entry(file: h5py.File, dataset: str | None, linked: LinkedFiles | None) -> h5py.Group | None:
    entries = find_entries(file, linked)
    if dataset is not None:
        chosen = find(file, f"/{dataset}", linked)
        if chosen is None:
            return None
        return next((entry for entry in entries if chosen in (entry, find(entry, nxtomo.DATA, linked))), None)
    if len(entries) > 1:
        names = ", ".join(name_of(entry).strip("'") for entry in entries)
        raise UnreadableScan(
            "dataset-ambiguous", f"the file holds several NXtomo entries ({names}); name the right one with dataset"
        )
    return entries[0] if entries else None


def _read_plain(file: h5py.File, selection: Wanted, bounds: Bounds) -> FileContents:
    by_name, dataset = dict(datasets(file, bounds.linked)), selection.dataset
    named = None if dataset is None else find(file, f"/{dataset}", bounds.linked)
    if dataset is not None and isinstance(named, h5py.Dataset):
        by_name[dataset.strip("/")] = named  # by the requested name, which may be a link's
    matlab = any("MATLAB_class" in node.attrs for node in by_name.values())
    arrays = NamedArrays(
        format="mat-v7.3" if matlab else "hdf5",
        infos={name: _info(node) for name, node in by_name.items()},
        load=partial(_load, by_name, bounds.whole),
        projections=partial(_projections, by_name, bounds),
        text=partial(_text, by_name, bounds.whole),
        remarks=lambda name: fields.packing_remarks(by_name[name]),
        stated_angles=lambda name: _angles_of_cil(file, name, bounds.whole),
    )
    return read_named_arrays(arrays, selection, (ReadingMessage.MATLAB_AXES(),) if matlab else ())


def _angles_of_cil(file: h5py.File, name: str, bounds: Bounds) -> FileAngles:
    """Read the angles next to projections that CIL wrote: in the group config of their entry."""
    entry, _, place = name.rpartition("/data/data")
    return (
        fields.read_angles(file, f"{entry}/config/angles", bounds, default_unit=None)
        if entry and not place
        else FileAngles()
    )


def _info(node: h5py.Dataset) -> ArrayInfo:
    shape = node.shape or ()
    matlab_class = attribute_text(node, "MATLAB_class")
    numeric = node.dtype.kind in "iuf" and (matlab_class is None or matlab_class in MATLAB_NUMBERS)
    kind = quoted(matlab_class or node.dtype.name)
    if matlab_class is not None:
        return ArrayInfo(shape[::-1], numeric, kind)
    return ArrayInfo(shape, numeric, kind, fields.stated_order(node) if len(shape) in {2, 3} else None)


def _checked(by_name: dict[str, h5py.Dataset], bounds: Bounds, name: str) -> h5py.Dataset:
    node, where = by_name[name], repr(quoted(name))
    if attribute_text(node, "MATLAB_class") != "char":
        check_matlab_class(where, attribute_text(node, "MATLAB_class"))
    check_dataset(where, node, bounds)
    if np.any(attribute(node, "MATLAB_empty")):
        raise UnreadableScan("wrong-shape", f"{where} is empty; it must hold numbers")
    return node


def _projections(by_name: dict[str, h5py.Dataset], bounds: Bounds, name: str) -> Projections:
    node = _checked(by_name, bounds, name)
    stored = fields.all_views(node)
    return in_order(stored, tuple(reversed(range(node.ndim)))) if "MATLAB_class" in node.attrs else stored


def _load(by_name: dict[str, h5py.Dataset], bounds: Bounds, name: str) -> NDArray[Any]:
    node = _checked(by_name, bounds, name)
    values = read_values(node, np.float64 if name in {"angles_deg", "angles_rad"} else np.float32)
    values = fields.scaling_of(node).apply(values)
    return values.T if "MATLAB_class" in node.attrs else values


def _text(by_name: dict[str, h5py.Dataset], bounds: Bounds, name: str) -> str | None:
    """Read a short text as MATLAB stores it, by character codes."""
    is_text = attribute_text(by_name[name], "MATLAB_class") == "char" and by_name[name].dtype.kind == "u"
    if not is_text or (by_name[name].size or LONGEST_TEXT + 1) > LONGEST_TEXT:
        return None
    return "".join(map(chr, read_values(_checked(by_name, bounds, name)).reshape(-1)))
