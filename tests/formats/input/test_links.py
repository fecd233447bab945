"""HDF5 as synchrotrons write it: links into other files, virtual datasets and raw data, read where asked for."""

import resource

import h5py
import numpy as np
import pytest
from scan_files import CELLS, ROWS, VIEWS, hdf5, refused

from sawmill_formats.input.angles import AngleSteps
from sawmill_formats.input.hdf5.links import FILES_KEPT_FREE
from sawmill_formats.input.reading import reading_scan

GIVEN = {"counts": False, "angles_deg": AngleSteps(0.0, 60.0)}
LINKED = GIVEN | {"follow_links": True}
SHAPE = (VIEWS, ROWS, CELLS)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "scan/raw").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    return tmp_path / "scan"


def frames(path, images, **stored):
    with h5py.File(path, "w") as file:
        file.create_dataset("entry/frames", data=images.astype(np.uint16), **stored)


def master(folder, layout):
    with h5py.File(folder / "master.h5", "w") as file:
        file.create_virtual_dataset("data", layout)


def linked(folder, stack):
    """A link to the data, by a further link in the file that it leads to."""
    frames(folder / "raw/b.h5", stack)
    hdf5({"here": h5py.ExternalLink("b.h5", "/entry/frames")})(folder / "raw/a.h5")
    hdf5({"exchange/data": h5py.ExternalLink("raw/a.h5", "here")})(folder / "master.h5")
    return ["a.h5", "b.h5"]


def virtual(folder, stack):
    """Two files of three views each, and one that is virtual itself."""
    layout = h5py.VirtualLayout(SHAPE, np.uint16)
    for index, views in enumerate((slice(0, 3), slice(3, 6))):
        frames(folder / f"raw/{index}.h5", stack[views], chunks=(1, ROWS, CELLS), compression="gzip")
        layout[views] = h5py.VirtualSource(f"raw/{index}.h5", "entry/frames", stack[views].shape)
    with h5py.File(folder / "master.h5", "w") as file:
        file.create_virtual_dataset("inner", layout)
        outer = h5py.VirtualLayout(SHAPE, np.uint16)
        outer[:] = h5py.VirtualSource(file["inner"])
        file.create_virtual_dataset("exchange/data", outer)
        file["inner"].attrs["what"] = "of the same file"
    return ["0.h5", "1.h5"]


def raw(folder, stack):
    data = stack.astype("<u2").tobytes()
    (folder / "raw/0.bin").write_bytes(b"head" + data[:100])
    (folder / "raw/1.bin").write_bytes(data[100:])
    places = [("raw/0.bin", 4, 100), ("raw/1.bin", 0, h5py.h5f.UNLIMITED)]
    with h5py.File(folder / "master.h5", "w") as file:
        file.create_dataset("exchange/data", shape=SHAPE, dtype="<u2", external=places)
    return ["0.bin", "1.bin"]


@pytest.mark.parametrize("write", [linked, virtual, raw])
def test_data_in_other_files_are_read_as_they_are(write, folder, stack):
    names = write(folder, stack)
    with reading_scan(folder / "master.h5", **LINKED) as scan:
        read = np.zeros(SHAPE, np.float32)
        for block in scan.blocks(1):  # in the smallest pieces
            read[block.views, block.rows] = block.samples
        np.testing.assert_array_equal(read, stack)
        assert [path.name for path in scan.others] == names
        assert scan.format == "hdf5-data-exchange"


@pytest.mark.parametrize("write", [linked, virtual, raw])
def test_an_upload_leads_nowhere_and_the_file_that_is_missing_is_named(write, folder, stack):
    write(folder, stack)
    assert "--follow-links" not in refused(folder / "master.h5", "external-storage", **GIVEN)
    name = write(folder, stack)[-1]
    (folder / "raw" / name).unlink()
    refused(folder / "master.h5", "linked-file-missing", name, **LINKED)


@pytest.mark.parametrize("write", [virtual, raw])
def test_what_was_never_written_is_not_filled_up(write, folder, stack):
    name = write(folder, stack)[-1]
    if write is raw:
        (folder / "raw" / name).write_bytes(b"short")
    else:
        frames(folder / "raw" / name, stack[3:5])
    refused(folder / "master.h5", "truncated-file", **LINKED)


def test_a_virtual_dataset_that_its_sources_do_not_fill_is_refused(folder, stack):
    frames(folder / "raw/0.h5", stack[:3])
    layout = h5py.VirtualLayout(SHAPE, np.uint16)
    layout[:3] = h5py.VirtualSource("raw/0.h5", "entry/frames", stack[:3].shape)
    master(folder, layout)
    refused(folder / "master.h5", "truncated-file", "72", "144", **LINKED)


def test_a_whole_nxtomo_entry_behind_a_link(folder, nxtomo, stack):
    nxtomo().rename(folder / "raw/scan.nxs")
    with h5py.File(folder / "master.h5", "w") as file:
        file["entry"] = h5py.ExternalLink(str(folder / "moved away/../raw/scan.nxs"), "/scan_1")
        file["lost"] = h5py.ExternalLink("nowhere.h5", "/")
    (folder / "moved away").mkdir()
    with reading_scan(folder / "master.h5", counts=True, follow_links=True) as scan:
        assert (scan.format, scan.detector_pitch_mm) == ("hdf5-nxtomo", pytest.approx(1.5))
        np.testing.assert_array_equal(next(scan.blocks(2**20)).samples, stack)


def test_an_absolute_place_that_was_moved_is_found_beside_the_file(folder, stack):
    frames(folder / "frames.h5", stack)
    hdf5({"data": h5py.ExternalLink("/no/such/folder/frames.h5", "entry/frames")})(folder / "master.h5")
    with reading_scan(folder / "master.h5", **LINKED) as scan:
        assert scan.shape == SHAPE


def test_links_that_run_in_a_circle_between_files_end_and_a_device_is_no_file(folder):
    for one, other in (("master.h5", "raw/other.h5"), ("raw/other.h5", "../master.h5")):
        hdf5({"exchange/data": h5py.ExternalLink(other, "/exchange/data")})(folder / one)
    refused(folder / "master.h5", "unsupported-storage", **LINKED)
    with h5py.File(folder / "master.h5", "w") as file:
        file.create_dataset("data", shape=SHAPE, dtype="u2", external=[("/dev/zero", 0, h5py.h5f.UNLIMITED)])
    refused(folder / "master.h5", "linked-file-missing", **LINKED)


def test_sizes_count_against_the_memory_and_what_is_stored(folder, stack):
    layout = h5py.VirtualLayout((100_000, ROWS, CELLS * 100), np.uint16)
    frames(folder / "raw/0.h5", np.tile(stack[:1], (1, 1, 100)))
    for view in range(0, 100_000, 10_000):
        layout[view] = h5py.VirtualSource("raw/0.h5", "entry/frames", (1, ROWS, CELLS * 100))
    master(folder, layout)
    refused(folder / "master.h5", "truncated-file", **LINKED, max_bytes=2**20)
    virtual(folder, stack)
    refused(folder / "master.h5", "too-large", "at most 100", **LINKED, max_bytes=100)


def test_filters_of_other_files_are_counted_too(folder, stack):
    frames(folder / "raw/0.h5", stack, scaleoffset=0)
    hdf5({"data": h5py.ExternalLink("raw/0.h5", "entry/frames")})(folder / "master.h5")
    refused(folder / "master.h5", "unsupported-storage", **LINKED)


def test_more_files_than_may_be_open_are_refused_with_the_remedy(folder, stack):
    layout = h5py.VirtualLayout((60, ROWS, CELLS), np.uint16)
    for view in range(60):
        frames(folder / f"raw/{view}.h5", stack[:1])
        layout[view] = h5py.VirtualSource(f"raw/{view}.h5", "entry/frames", (1, ROWS, CELLS))
    master(folder, layout)
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (FILES_KEPT_FREE + 59, before[1]))
    words = "leads to 60 files and 59 may be open at once", "ulimit -n"
    try:
        refused(folder / "master.h5", "too-large", *words, **LINKED)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_fields_apart_may_be_linked_too(folder, stack):
    linked(folder, stack)
    np.save(folder / "scan.npy", stack)
    with reading_scan(folder / "scan.npy", **LINKED | {"counts": True}, flats=folder / "master.h5") as scan:
        np.testing.assert_array_equal(scan.flats, stack)
        assert [path.name for path in scan.others] == ["master.h5", "a.h5", "b.h5"]
