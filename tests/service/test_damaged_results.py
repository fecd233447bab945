"""Files of results that were damaged or replaced in the data folder: one problem document, and nothing read."""

import os
import subprocess
import sys
from contextlib import contextmanager

import h5py
import numpy as np
import pytest
from damaged_files import DAMAGES, another_file

from sawmill_contracts import job_kinds
from sawmill_formats import reading_apart
from sawmill_formats.errors import UnreadableScan
from sawmill_platform.errors import DamagedResult

SCAN, LOG, FOUND = "/v1/scans/example", "/v1/reconstructions/example-sparse", "/v1/calibrations/example"
# The values of each file, what is made of them first, and what else.
FILES = {
    "scan": (job_kinds.INGEST, "example/scan.h5", "entry/instrument/detector/data", f"{SCAN}/sinogram.png?row=0"),
    "volume": (job_kinds.RECONSTRUCT, "example-sparse/volume.h5", "entry/reconstruction/data", f"{LOG}/slices/0.npy"),
    "calibration": (job_kinds.CALIBRATE, "example/result.h5", "entry/arrays/sinogram", f"{FOUND}/result.h5"),
}
OTHERS = {
    "scan": ["preview", "thumbnail.png"],
    "volume": [
        *("slices/0.png", "slices/0.png?show=deviation", "mosaic.png", "side.png", "side.npy", "thumbnail.png"),
        *("alpha-curve.png", "volume.h5"),
    ],
    "calibration": ["report.png", "overlay.png", "log-before.png"],
}


def file_of(store, result):
    kind, name, values, first = FILES[result]
    return store.files.folder / kind.plural / name, values, first


def check_problem(answer):
    assert (answer.status_code, answer.headers["Content-Type"]) == (409, "application/problem+json"), answer.url
    assert answer.json()["code"] == "result-damaged"


@contextmanager
def changed_byte(path, place, value):
    """Change one byte, and nothing of the file's name, size and time of change."""

    def write(byte):
        with path.open("r+b") as file:
            file.seek(place)
            file.write(bytes([byte]))
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))

    before, byte = path.stat(), path.read_bytes()[place]
    write(value)
    yield
    write(byte)


def every_change(path):
    """Each byte of the first 8 KB set to 0, to 255 and to a value of chance, where that changes it."""
    chance = np.random.default_rng(2047).integers(256, size=8192)
    for place, byte in enumerate(path.read_bytes()[:8192]):
        for value in {0, 255, int(chance[place])} - {byte}:
            yield place, value


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_one_problem(seeded, store, damage):
    for result in FILES:
        path, values, first = file_of(store, result)
        DAMAGES[damage](path, values)
        check_problem(seeded.get(first))
    check_problem(seeded.get(f"{LOG}/volume.h5"))


@pytest.mark.parametrize("result", FILES)
def test_so_is_everything_that_is_made_of_it(seeded, store, result):
    path, _, first = file_of(store, result)
    another_file(path, "")
    for name in OTHERS[result]:
        check_problem(seeded.get(f"{first.rpartition('/')[0].removesuffix('/slices')}/{name}"))


def test_an_array_with_other_axes_is_one_problem(seeded, store):
    path, _, _ = file_of(store, "calibration")
    with h5py.File(path, "r+") as file:
        del file["entry/arrays/phantom_image"]
        file["entry/arrays/phantom_image"] = [1.0]
    check_problem(seeded.get(f"{FOUND}/report.png"))


@pytest.mark.parametrize("page", ["/logs/example-sparse", "/calibrations/example/report"])
def test_a_page_of_it_gives_the_sentence(seeded, store, page):
    for result in FILES:
        another_file(file_of(store, result)[0], "")
    answer = seeded.get(page, headers={"Accept": "text/html"})
    assert answer.status_code == 409
    assert "is another file than the job wrote" in answer.text


@pytest.mark.parametrize("result", FILES)
def test_no_changed_byte_is_parsed_and_the_time_of_change_does_not_tell(seeded, store, result):
    """A byte's fault may end the process, with all tests: that this one ends is part of what it says."""
    path, _, first = file_of(store, result)
    whole, generator = path.read_bytes(), np.random.default_rng(47)
    collection = whole.find(b"GCOL")
    sizes_in_the_heap = [] if collection < 0 else [collection + 24]  # which 255 makes an endless loop of
    for number, place in enumerate([*sizes_in_the_heap, *generator.integers(len(whole), size=100)]):
        with changed_byte(path, int(place), 255 if whole[place] != 255 else 0):
            with pytest.raises(DamagedResult):
                store.files.verified.digest(path)
            if number % 25 == 0:
                check_problem(seeded.get(first))
    assert seeded.get(first).status_code == 200
    assert seeded.get("/health/live").status_code == 200


@pytest.mark.nightly
@pytest.mark.parametrize("result", FILES)
def test_each_byte_of_a_beginning_is_compared(store, seeded, result):  # noqa: ARG001 - the examples are in the store
    path, _, _ = file_of(store, result)
    for place, value in every_change(path):
        with changed_byte(path, place, value), pytest.raises(DamagedResult):
            store.files.verified.digest(path)


# Walks through the file of each change, and then reads it as the service does.
READER = """
import resource, sys, time
from pathlib import Path
from sawmill_formats import hdf5_walk
from sawmill_formats.errors import FileError
from sawmill_formats.output import calibration_file, scan_reader, volume_reader
from sawmill_platform.errors import DamagedResult

def scan(path):
    scan_reader.check_scan(path, (12, 4, 16))
    scan_reader.sinogram(path, (12, 4, 16), 0)

def volume(path):
    volume_reader.check_volume(path, (3, 32, 32))
    volume_reader.alpha_curve(path)
    volume_reader.side_view(path, (3, 32, 32), "x")
    for _ in volume_reader.volume_slices(path, (3, 32, 32), range(3)):
        pass

def calibration(path):
    calibration_file.read_calibration(path)

path, read = Path(sys.argv[1]), {"scan": scan, "volume": volume, "calibration": calibration}[sys.argv[2]]
whole = path.read_bytes()
read(path)  # loads kernels, which takes a second or two
for line in sys.stdin:
    place, value = map(int, line.split())
    path.write_bytes(whole[:place] + bytes([value]) + whole[place + 1:])
    resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time()) + 2, resource.RLIM_INFINITY))
    print("walk", place, value, flush=True)
    hdf5_walk.walk(path, follow_links=False)
    print("read", place, value, flush=True)
    try:
        read(path)
    except (DamagedResult, FileError):
        pass
print("end", flush=True)
"""


def last_words(path, result, changes):
    """Read the file of each change in a process; return what it did last before it ended, or was ended in a loop."""
    asked = "".join(f"{place} {value}\n" for place, value in changes)
    command = [sys.executable, "-c", READER, str(path), result]
    done = subprocess.run(command, input=asked, capture_output=True, text=True, timeout=3000, check=False)
    return done.stdout.splitlines()[-1].split()


def is_refused(path, place, value):
    """Return whether a separate process finds the change; one that takes seconds it may survive."""
    with changed_byte(path, place, value):
        try:
            reading_apart.read_apart(path, limit_s=10.0)
        except UnreadableScan as refusal:
            return refusal.code == "broken-file"
    return False


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("result", FILES)
def test_what_a_walk_in_another_process_survives_a_reader_survives(store, seeded, result, tmp_path):  # noqa: ARG001
    """As of results of version 0.1.0, before their digests are noted; each byte takes one of the values in turn."""
    original, _, _ = file_of(store, result)
    path, changes, ended = tmp_path / original.name, list(every_change(original))[::4], []
    while changes:
        path.write_bytes(original.read_bytes())
        what, *change = last_words(path, result, changes)
        if what == "end":
            break
        ended.append(tuple(map(int, change)))
        # An earlier change may have damaged the process's memory: alone, the file must end the walk or nothing.
        path.write_bytes(original.read_bytes())
        assert what == "walk" or last_words(path, result, ended[-1:])[0] != "read", ended[-1]
        changes = changes[changes.index(ended[-1]) + 1 :]
    assert any(is_refused(original, *change) for change in ended)
