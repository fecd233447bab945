"""HDF5 files that crash or stop their reader do so in a process of their own."""

import errno
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest
from machine_faults import at_call, refusing
from results import endless

from sawmill_calibration import read_scan
from sawmill_calibration.result_file import read_calibration
from sawmill_calibration.scans.inspect import InspectionInput, inspect_file
from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.hdf5.listing import hdf5_parts
from sawmill_formats.input.reading import reading_bounds
from sawmill_formats.reading_apart import read_apart

LIMIT_S = 1.5  # a process that starts takes a third of it


@pytest.fixture
def honest(tmp_path):
    """A file of chunks, texts, two names of one object, and a link that leads nowhere."""
    path = tmp_path / "honest.h5"
    with h5py.File(path, "w", libver="latest") as file:
        file.create_dataset("data", data=np.ones((4, 4, 8)), chunks=(1, 2, 8), maxshape=(None, None, None))
        file["texts"] = np.array(["alpha", "beta"], h5py.string_dtype())
        file["again"], file["data"].attrs["unit"] = file["data"], "mm"
        file["nowhere"] = h5py.SoftLink("/nowhere")
    return path


def test_a_reader_that_loops_or_crashes_is_a_broken_file(tmp_path, honest):
    endless(loops := tmp_path / "endless.h5")
    crash = (sys.executable, "-S", "-c", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    for path, given, sentence in (
        (loops, {"limit_s": LIMIT_S}, r"reading the file did not get on for 1\.5 seconds: it is damaged"),
        (honest, {"walk": crash}, r"crashed the reader \(SIGSEGV\): it is damaged, or needs more"),
    ):
        with pytest.raises(UnreadableScan, match=sentence) as refusal:
            read_apart(path, **given)
        assert refusal.value.code == "broken-file"


def test_an_honest_file_is_read_apart_once_until_it_changes(honest):
    read_apart(honest)
    with at_call("subprocess.Popen", refusing(errno.EAGAIN)):
        read_apart(honest)
        with honest.open("ab") as file:
            file.write(b"more")
        with pytest.raises(BlockingIOError):
            read_apart(honest)


def test_a_link_to_another_file_is_followed_only_where_links_are(tmp_path):
    endless(tmp_path / "endless.h5")
    with h5py.File(path := tmp_path / "linked.h5", "w") as file:
        file["texts"] = h5py.ExternalLink("endless.h5", "texts")
    read_apart(path)
    with pytest.raises(UnreadableScan, match="did not get on"):
        read_apart(path, follow_links=True, limit_s=LIMIT_S)


READERS = {
    "read_scan": lambda path: read_scan(path, data="counts", source_to_cor_mm=859.46),
    "flats": lambda path: read_scan(__file__, data="counts", source_to_cor_mm=859.46, flats=path),
    "inspect": lambda path: inspect_file(InspectionInput(path)),
    "calibration": read_calibration,
}


@pytest.mark.parametrize("reader", READERS)
def test_whatever_reads_a_file_of_a_user_has_it_read_apart_first(honest, reader):
    with at_call("subprocess.Popen", refusing(errno.EAGAIN)), pytest.raises(BlockingIOError):
        READERS[reader](honest)


def test_an_index_of_chunks_that_is_damaged_does_not_crash_the_listing(honest):
    """The library's measuring of an object crashed on these: that this test ends is what it says."""
    whole = honest.read_bytes()
    for start in [found.start() for found in re.finditer(b"BTHD", whole)]:
        for place in range(start, start + 38):
            honest.write_bytes(whole[:place] + bytes([255 - whole[place]]) + whole[place + 1 :])
            with suppress(OSError, RuntimeError):
                list(hdf5_parts(honest, reading_bounds(None)))


@pytest.mark.nightly
@pytest.mark.parametrize("command", ["inspect", "calibrate"])
def test_a_command_ends_on_a_file_whose_reader_loops(tmp_path, command):
    endless(path := tmp_path / "endless.h5")
    flags = {"inspect": [], "calibrate": ["--data", "counts", "--source-to-cor-mm", "859", "--phantom", "l-shape"]}
    program = [Path(sys.executable).with_name("sawmill"), command, path, *flags[command]]
    done = subprocess.run(program, capture_output=True, text=True, timeout=600, check=False)
    assert "reading the file did not get on for 60 seconds: it is damaged" in done.stdout + done.stderr
