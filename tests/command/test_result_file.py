"""--calibration: what `calibrate --json` printed and the service's `result.h5` are as good as each other."""

import json
import struct

import h5py
import numpy as np
import pytest
from PIL import Image

MOST_BYTES = 16 * 2**20


def volume(path) -> np.ndarray:
    with h5py.File(path) as file:
        return file["entry/reconstruction/data"][()]


def test_result_h5_alone_is_enough_to_reconstruct(run, stack, result_file, result_hdf5, tmp_path):
    flags = ("--data", "counts", "--rows", "2:3", "--method", "fbp")
    run("reconstruct", stack, *flags, "--calibration", result_file, "-o", tmp_path / "json.h5")
    run("reconstruct", stack, *flags, "--calibration", result_hdf5, "-o", tmp_path / "hdf5.h5")
    assert np.array_equal(volume(tmp_path / "json.h5"), volume(tmp_path / "hdf5.h5"))


JSON = "entry/calibration_json"


def hdf5_of(value, name=JSON):
    """Write HDF5 with this value, or with one that is made of the result's file."""

    def write(path, result):
        with h5py.File(path, "w") as file:
            file[name] = value(result) if callable(value) else value

    return write


def incomplete(result):
    with h5py.File(result) as file:
        known = json.loads(file[JSON][()])
    known["theta"].pop("detector_tilt")
    return json.dumps(known)


def text_of(shape, kind, **storage):
    """Write HDF5 with a text that is stored so, and was never written."""

    def write(path, _result):
        with h5py.File(path, "w") as file:
            file.create_dataset(JSON, shape, kind, **storage)

    return write


def text_that_claims_more_than_there_is(path, _result):
    with h5py.File(path, "w") as file:
        file[JSON] = "{}".ljust(1234)
        at = file[JSON].id.get_offset()
    whole = bytearray(path.read_bytes())
    assert struct.unpack_from("<I", whole, at) == (1234,)
    struct.pack_into("<I", whole, at, 0xFFFF_FFF0)
    path.write_bytes(whole)


def huge_json(path, _result):
    with path.open("wb") as stream:
        stream.truncate(3 * 2**30)


PACKED = {"chunks": (2**20,), "maxshape": (None,), "compression": "gzip"}


@pytest.mark.parametrize(
    ("write", "reason"),
    [
        (lambda path, _: Image.new("L", (32, 32), 128).save(path, format="PNG"), "it is neither JSON nor HDF5"),
        (hdf5_of(np.zeros((4, 4)), "entry/data"), "it is HDF5 without /entry/calibration_json"),
        (lambda path, result: path.write_bytes(result.read_bytes()[:-100]), "truncated file"),
        (hdf5_of(3.0), "it is HDF5 without /entry/calibration_json"),
        (hdf5_of("no JSON"), "Invalid JSON"),
        (hdf5_of(incomplete), "theta.detector_tilt: Field required"),
        (hdf5_of(lambda result: h5py.ExternalLink(str(result), f"/{JSON}")), "leads through an external link"),
        (text_of((), f"S{MOST_BYTES + 1}"), "16777217 bytes"),
        (text_of((1,), "S1024", **PACKED), "1073741824 bytes"),
        (text_that_claims_more_than_there_is, "4294967280 bytes"),
        (lambda path, _: path.write_text("[" * 2**20), "it is neither JSON nor HDF5"),
        (huge_json, "it has more than 16777216 bytes"),
    ],
)
def test_what_is_neither_is_refused_in_one_sentence(failure, stack, result_hdf5, tmp_path, write, reason):
    path = tmp_path / "given"
    write(path, result_hdf5)
    flags = ("--data", "counts", "--calibration", path, "-o", tmp_path / "out.h5")
    reported = failure("reconstruct", stack, *flags)
    assert (reported["kind"], reported["code"]) == ("input", "calibration")
    assert reported["detail"].startswith(
        "given is neither what calibrate --json prints nor a calibration's result.h5: "
    )
    assert reason in reported["detail"]
    assert "\n" not in reported["detail"]
    assert not (tmp_path / "out.h5").exists()
