"""Files of results that were damaged or replaced in the data folder: one problem document, and nothing read."""

import os
from contextlib import contextmanager

import h5py
import numpy as np
import pytest
from results import DAMAGES, another_file

from sawmill_contracts import kinds
from sawmill_platform.errors import DamagedResult

SCAN, LOG, FOUND = "/v1/scans/example", "/v1/reconstructions/example-sparse", "/v1/calibrations/example"
# The values of each file, what is made of them first, and what else.
FILES = {
    "scan": (kinds.INGEST, "example/scan.h5", "entry/instrument/detector/data", f"{SCAN}/sinogram.png?row=0"),
    "volume": (kinds.RECONSTRUCT, "example-sparse/volume.h5", "entry/reconstruction/data", f"{LOG}/slices/0.npy"),
    "calibration": (kinds.CALIBRATE, "example/result.h5", "entry/arrays/sinogram", f"{FOUND}/result.h5"),
}
SLICES = ("slices/0.png", "slices/0.png?show=deviation", "mosaic.png", "side.png", "side.npy", "thumbnail.png")
OTHERS = {
    "scan": ["preview", "thumbnail.png"],
    "volume": [*SLICES, "alpha-curve.png", "volume.h5"],
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


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_one_problem(seeded, store, damage):
    for result in FILES:
        path, values, first = file_of(store, result)
        DAMAGES[damage](path, values)
        check_problem(seeded.get(first))
    check_problem(seeded.get(f"{LOG}/volume.h5"))


def test_an_array_with_other_axes_is_one_problem_and_so_is_everything_that_is_made_of_a_damaged_file(seeded, store):
    path, _, _ = file_of(store, "calibration")
    with h5py.File(path, "r+") as file:
        del file["entry/arrays/phantom_image"]
        file["entry/arrays/phantom_image"] = [1.0]
    check_problem(seeded.get(f"{FOUND}/report.png"))
    for result in FILES:
        another_file(file_of(store, result)[0], "")
    for page in ("/logs/example-sparse", "/calibrations/example/report"):
        answer = seeded.get(page, headers={"Accept": "text/html"})
        assert (answer.status_code, "is another file than the job wrote" in answer.text) == (409, True)
    for result in FILES:
        path, _, first = file_of(store, result)
        another_file(path, "")
        for name in OTHERS[result]:
            check_problem(seeded.get(f"{first.rpartition('/')[0].removesuffix('/slices')}/{name}"))


def test_no_changed_byte_is_parsed_and_the_time_of_change_does_not_tell(seeded, store):
    """A byte's fault may end the process, with all tests: that this one ends is part of what it says."""
    for result in FILES:
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
        assert (seeded.get(first).status_code, seeded.get("/health/live").status_code) == (200, 200)
