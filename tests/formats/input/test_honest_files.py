"""Honest files as other programs write them: all views in order, with angles and fields, and no remark but facts."""

import zipfile

import numpy as np
import pytest
import tifffile
from scan_files import hdf5, mat, npz, saved

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AngleSteps
from sawmill_formats.input.reading import reading_scan

RNG = np.random.default_rng(20261129)
VIEWS, ROWS, CELLS, FIELDS = 90, 2, 16, 3
STACK = RNG.integers(9_000, 20_000, (VIEWS, ROWS, CELLS)).astype(np.uint16)
FLATS, DARKS = (
    RNG.integers(low, high, (FIELDS, ROWS, CELLS)).astype(np.uint16) for low, high in ((20_000, 21_000), (140, 160))
)
ANGLES = 0.5 + 4.0 * np.arange(VIEWS)
STEPS = {"angles_deg": AngleSteps(0.5, 4.0)}
DETECTOR, THETA = "entry/instrument/detector/", "entry/sample/rotation_angle"
DATA, EXCHANGE_DETECTOR = "exchange/data", "measurement/instrument/detector/"


def images(views, flats, darks):
    """Members of an archive by patterns of their names: `n` counts, `a` is the angle."""
    return {
        pattern.format(n=n, a=ANGLES[n]): saved(tifffile.imwrite, image, photometric="minisblack")
        for pattern, stack in ((views, STACK), (flats, FLATS), (darks, DARKS))
        for n, image in enumerate(stack)
    }


def archive(*patterns, **others):
    """A ZIP of images in any order, as a program packs them, and other files."""

    def write(path):
        members = images(*patterns) | others
        with zipfile.ZipFile(path, "w") as file:
            for n in np.random.default_rng(48).permutation(len(members)):
                file.writestr([*members][n], [*members.values()][n])

    return write


def folder(*patterns):
    def write(path):
        path.mkdir()
        for name, data in images(*patterns).items():
            (path / name).write_bytes(data)

    return write


def stacks(**options):
    """Three TIFFs of several pages in an archive, by tifffile or as ImageJ writes them."""

    def write(path):
        with zipfile.ZipFile(path, "w") as file:
            for name, stack in (("log17.tif", STACK), ("log17_flat.tif", FLATS), ("log17_dark.tif", DARKS)):
                file.writestr(name, saved(tifffile.imwrite, stack, **options))

    return write


def nxtomo(angles, unit, **members):
    keys = np.repeat([2, 1, 0], [FIELDS, FIELDS, VIEWS])
    arrays = {"data": np.concatenate([DARKS, FLATS, STACK]), "image_key": keys, "x_pixel_size": 0.15} | members
    paths = {DETECTOR + name: value for name, value in arrays.items()} | {"entry/definition": "NXtomo", THETA: angles}
    return hdf5(paths, [(THETA, "units", unit), (DETECTOR + "x_pixel_size", "units", "cm")])


def exchange(fields, **members):
    arrays = {"data": STACK, "theta": ANGLES.astype(np.float32)} | fields
    paths = {f"exchange/{name}": value for name, value in arrays.items()}
    paths |= {EXCHANGE_DETECTOR + name: value for name, value in ({"x_pixel_size": 1500.0} | members).items()}
    return hdf5(paths, [(EXCHANGE_DETECTOR + "x_pixel_size", "units", "um"), ("exchange/data", "units", "counts")])


ALL_IMAGES = np.r_[np.full(2 * FIELDS, 180.0), ANGLES]
OF_NUMPY = {"projections": STACK, "flats": FLATS, "darks": DARKS, "angles_deg": ANGLES}
BEFORE_AND_AFTER = {"data_white_pre": FLATS[:2], "data_white_post": FLATS[2:], "data_dark": DARKS}
CAMERA = {"x_binning": 1, "y_binning": 0, "exposure_time": 0.1}


def alone(write, *facts, **given):
    return write, given, set(facts)


def in_steps(write, *facts):
    return alone(write, *facts, **STEPS)


FILES = {
    "a counter with zeros": in_steps(archive("scan_{n:04d}.tif", "flat_{n:04d}.tif", "dark_{n:04d}.tif")),
    "a counter without zeros, capitals": in_steps(folder("SCAN{n}.TIF", "FLAT{n}.TIF", "DARK{n}.TIF")),
    "angles": in_steps(folder("TOMO_{a:.2f}.tif", "ff{n:02d}.tif", "df{n:02d}.tif")),
    "a date, a counter and the angle": in_steps(
        archive("2024-03-05_log17_{n:03d}_{a:.1f}.tif", "2024-03-05_log17_flat{n}.tif", "2024-03-05_log17_dark{n}.tif")
    ),
    "voltage, exposure and a counter": in_steps(
        folder("pine_120kV_0.25s_{n}.tif", "pine_120kV_0.25s_white_{n}.tif", "pine_120kV_0.25s_dark_{n}.tif")
    ),
    "folders of each kind": in_steps(archive("log/proj/{n}.tif", "log/flats/{n}.tif", "log/darks/{n}.tif")),
    "IMAT": in_steps(archive("Tomo/L_{n:04d}.tif", "Flat_Before/L_{n:04d}.tif", "Dark_After/L_{n:04d}.tif")),
    "twins of macOS": in_steps(
        archive("scan {n}.tif", "flat {n}.tif", "dark {n}.tif", **{"__MACOSX/._scan 1.tif": b"\0\5\26\7"}),
        "other-files",
    ),
    "a log file": in_steps(archive("log~{n:08d}.tif", "io{n}.tif", "di{n}.tif", **{"log~.log": b"a=1"}), "other-files"),
    "stacks by tifffile": in_steps(stacks(photometric="minisblack", compression="zlib", predictor=True)),
    "stacks of ImageJ": in_steps(stacks(imagej=True, resolution=(0.5, 0.5), metadata={"unit": "mm"})),
    "NXtomo": alone(nxtomo(ALL_IMAGES, "degree")),
    "NXtomo in radians": alone(nxtomo(np.deg2rad(ALL_IMAGES), "rad")),
    "NXtomo of nxtomomill": alone(
        nxtomo(ALL_IMAGES.astype(np.float32), "deg", image_key_control=np.repeat([2, 1, 0], [FIELDS, FIELDS, VIEWS]))
    ),
    "Data Exchange": alone(exchange({"data_white": FLATS, "data_dark": DARKS}, **CAMERA)),
    "Data Exchange, flats twice": alone(exchange(BEFORE_AND_AFTER), "flats-by-name"),
    "plain HDF5": alone(hdf5({**OF_NUMPY, "time_s": np.arange(90.0)})),
    "NPZ of integers": alone(npz(**OF_NUMPY)),
    "NPZ of floats": alone(npz(**{name: array.astype(np.float32) for name, array in OF_NUMPY.items()})),
    "MAT": alone(mat(**OF_NUMPY)),
}


@pytest.mark.parametrize(("write", "given", "facts"), FILES.values(), ids=FILES)
def test_an_honest_file_is_read_without_a_remark(tmp_path, write, given, facts):
    write(tmp_path / "scan")
    with reading_scan(tmp_path / "scan", counts=True, **given) as scan:
        (block,) = scan.blocks(2**30)
        assert {remark.message.value for remark in scan.remarks} == facts
        assert np.array_equal(block.samples, STACK)
        assert np.allclose(np.rad2deg(scan.angles_rad), ANGLES, rtol=1e-6)
        for fields, stored in ((scan.flats, FLATS), (scan.darks, DARKS)):
            assert sorted(map(bytes, fields)) == sorted(map(bytes, stored.astype(np.float32)))
        assert scan.detector_pitch_mm in {None, 1.5}


@pytest.mark.parametrize(
    ("views", "step_deg"), [(50, 4.0), (60, -4.0), (90, 4.0), (91, 4.0), (103, -3.5), (60, 222.4922359), (90, 8.0)]
)
def test_turns_and_short_scans_are_read_without_a_remark(tmp_path, views, step_deg):
    """A disc that comes into each cell now and then, and noise around zero in the air."""
    place = 90.0 + 40.0 * np.sin(np.deg2rad(step_deg * np.arange(views)))[:, None] - np.arange(180.0)
    line_integrals = 0.05 * np.sqrt(np.clip(400.0 - place**2, 0.0, None)) + np.random.default_rng(views).normal(
        0.0, 0.01, place.shape
    )
    np.save(tmp_path / "scan.npy", line_integrals.astype(np.float32))
    with reading_scan(tmp_path / "scan.npy", counts=False, angles_deg=AngleSteps(0.0, step_deg)) as scan:
        assert [block.samples.shape for block in scan.blocks(2**30)] == [(views, 1, 180)]
        assert scan.remarks == ()


def test_images_of_unknown_names_are_quoted_where_flat_fields_are_missing(tmp_path):
    archive("scan_{n:03d}.tif", "shading_{n}.tif", "dark_{n}.tif")(tmp_path / "scan")
    refused = pytest.raises(UnreadableScan, match=r"3 images were left out.*\(shading_0.tif, shading_1.tif")
    with refused, reading_scan(tmp_path / "scan", counts=True, **STEPS):
        pass
