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


def as_picture(path, _result):
    Image.new("L", (32, 32), 128).save(path, format="PNG")


def as_another_hdf5(path, _result):
    with h5py.File(path, "w") as file:
        file["entry/data"] = np.zeros((4, 4))


def as_truncated(path, result):
    path.write_bytes(result.read_bytes()[:-100])


def as_number(path, _result):
    with h5py.File(path, "w") as file:
        file["entry/calibration_json"] = 3.0


def as_another_program_s_text(path, _result):
    with h5py.File(path, "w") as file:
        file["entry/calibration_json"] = "no JSON"


def as_incomplete(path, result):
    with h5py.File(result) as file:
        known = json.loads(file["entry/calibration_json"][()])
    known["theta"].pop("detector_tilt")
    with h5py.File(path, "w") as file:
        file["entry/calibration_json"] = json.dumps(known)


def as_link_elsewhere(path, result):
    with h5py.File(path, "w") as file:
        file["entry/calibration_json"] = h5py.ExternalLink(str(result), "/entry/calibration_json")


def as_long_text(path, _result):
    with h5py.File(path, "w") as file:
        file.create_dataset("entry/calibration_json", (), dtype=f"S{MOST_BYTES + 1}")


def as_packed_text(path, _result):
    with h5py.File(path, "w") as file:
        entry = file.create_group("entry")
        entry.create_dataset("calibration_json", (1,), "S1024", chunks=(2**20,), maxshape=(None,), compression="gzip")


def as_text_that_claims_more_than_there_is(path, _result):
    text = "{}".ljust(1234)
    with h5py.File(path, "w") as file:
        file["entry/calibration_json"] = text
        at = file["entry/calibration_json"].id.get_offset()
    whole = bytearray(path.read_bytes())
    assert struct.unpack_from("<I", whole, at) == (1234,)
    struct.pack_into("<I", whole, at, 0xFFFF_FFF0)
    path.write_bytes(whole)


def as_deep_json(path, _result):
    path.write_text("[" * 2**20)


def as_huge_json(path, _result):
    with path.open("wb") as stream:
        stream.truncate(3 * 2**30)


@pytest.mark.parametrize(
    ("write", "reason"),
    [
        (as_picture, "it is neither JSON nor HDF5"),
        (as_another_hdf5, "it is HDF5 without /entry/calibration_json"),
        (as_truncated, "truncated file"),
        (as_number, "it is HDF5 without /entry/calibration_json"),
        (as_another_program_s_text, "Invalid JSON"),
        (as_incomplete, "theta.detector_tilt: Field required"),
        (as_link_elsewhere, "leads through an external link"),
        (as_long_text, "16777217 bytes"),
        (as_packed_text, "1073741824 bytes"),
        (as_text_that_claims_more_than_there_is, "4294967280 bytes"),
        (as_deep_json, "it is neither JSON nor HDF5"),
        (as_huge_json, "it has more than 16777216 bytes"),
    ],
    ids=lambda value: value.__name__ if callable(value) else "",
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
