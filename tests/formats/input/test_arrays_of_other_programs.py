"""HDF5, NPZ and MAT files as other programs write them: read rightly, remarked or refused; and honest files."""

import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from scan_files import each_refusal, hdf5, npz, read_scan, refusal, refused

from sawmill_formats.errors import UnreadableScan, library_errors_translated
from sawmill_formats.hdf5 import open_hdf5
from sawmill_formats.input.angles import AngleList, AngleSteps
from sawmill_formats.input.reading import reading_scan

RNG = np.random.default_rng(20261128)
VIEWS, ROWS, CELLS = 6, 3, 8
STACK = RNG.integers(100, 60_000, (VIEWS, ROWS, CELLS)).astype(np.float32)
FLATS, DARKS = np.full((2, ROWS, CELLS), 61_000.0, np.float32), np.full((1, ROWS, CELLS), 7.0, np.float32)
ANGLES = np.array([0.5, 60.5, 121.0, 180.5, 240.5, 300.25])
DATA, THETA, DETECTOR = "exchange/data", "exchange/theta", "measurement/instrument/detector"
COUNTS, INTEGRALS = {"counts": True}, {"counts": False}


def exchange(*attributes, data=STACK, **members):
    """Data Exchange; members of the group exchange, or of the detector where they are called so."""
    own = {"theta": ANGLES, "data_white": FLATS, "data_dark": DARKS} | members
    paths = {f"{DETECTOR if name.endswith(('size', 'binning')) else 'exchange'}/{name}": own[name] for name in own}
    sizes = [(path, "units", "mm") for path in paths if path.endswith("size")]
    return hdf5(
        {DATA: data} | {path: value for path, value in paths.items() if value is not None}, [*attributes, *sizes]
    )


def nxtomo(angles, keys, **members):
    detector = "entry/instrument/detector/"
    own = {"entry/definition": "NXtomo", detector + "data": np.concatenate([DARKS, FLATS, STACK, STACK[:1]])}
    own |= {detector + name: value for name, value in ({"image_key": keys} | members).items() if value is not None}
    return hdf5(own | {"entry/sample/rotation_angle": angles}, [("entry/sample/rotation_angle", "units", "deg")])


def cil(order, *attributes, data=STACK):
    """The layout of CIL's NEXUSDataWriter: names of axes as attributes, angles in radians in another group."""
    place, angles = "entry1/tomo_entry/data/data", "entry1/tomo_entry/config/angles"
    names = [(place, f"dimension{axis}", name) for axis, name in enumerate(order)]
    units = [(angles, "angle_unit", "radian"), (angles, "initial_angle", np.float32(0.0))]
    of_data = [(place, name, value) for name, value in attributes]
    moved = np.moveaxis(data, (0, 1, 2), [order.index(name) for name in ("angle", "vertical", "horizontal")])
    return hdf5(
        {place: moved, angles: np.deg2rad(ANGLES)}, [*names, *units, *of_data, ("/", "creator", "NEXUSDataWriter.py")]
    )


def scan_of(write, path, **options):
    """Remarks by their codes, the scan's projections, angles in degrees, flats, darks and pitch."""
    write(path)
    with reading_scan(path, **options) as scan:
        (block,) = scan.blocks(2**30)
        remarks = {remark.message.value: remark.values for remark in scan.remarks}
        return remarks, block.samples, np.rad2deg(scan.angles_rad), scan.flats, scan.darks, scan.detector_pitch_mm


PACKED = (STACK.astype(np.int64) + 1000).astype(np.int32)
SCALED = [(DATA, "scale_factor", 2.0), (DATA, "add_offset", -2000.0)]
STORED_BY_CIL = (STACK * 0.5 + 25.0).astype(np.float32)
KEYS = [2, 1, 1, *[0] * VIEWS]
FIELDS_APART = {"data_white": None, "data_dark": None}
OF_NUMPY = {"projections": STACK, "flats": FLATS, "angles_deg": ANGLES}
TURNED = STACK.transpose(0, 2, 1)
IN_STEPS = {"angles_deg": AngleSteps(0.0, 60.0)}


def read_as(write, code=None, *, given=COUNTS, **values):
    """What is read as STACK, at ANGLES, with FLATS and DARKS where it is counts; the remark, and some of its values."""
    return write, given, code, values


READ = {
    "counts packed by CF, fields as they are": read_as(
        exchange(*SCALED, data=(STACK + 2000) / 2),
        "unpacked",
        names="scale_factor, add_offset",
        scale="2",
        offset="-2000",
    ),
    "a scale alone": read_as(exchange((DATA, "scale_factor", 0.5), data=STACK * 2), "unpacked", scale="0.5"),
    "packed by slope and intercept": read_as(
        exchange((DATA, "slope", 1), (DATA, "intercept", -1000), data=PACKED), "unpacked", offset="-1000"
    ),
    "packed as in DICOM": read_as(
        exchange((DATA, "RescaleSlope", 1), (DATA, "RescaleIntercept", -1000), data=PACKED), "unpacked", offset="-1000"
    ),
    "packed darks": read_as(
        exchange(("exchange/data_dark", "add_offset", 5.0), data_dark=DARKS - 5), "unpacked", path="exchange/data_dark"
    ),
    "packed angles": read_as(exchange((THETA, "scale_factor", 0.25), theta=ANGLES * 4), "unpacked", path=THETA),
    "packed in a plain file": read_as(
        hdf5({"projections": PACKED, "angles_deg": ANGLES}, [("projections", "add_offset", -1000.0)]),
        "unpacked",
        given=INTEGRALS,
        path="projections",
    ),
    "packed by CIL, its axes and angles": read_as(
        cil(["vertical", "angle", "horizontal"], ("scale", 0.5), ("offset", 25.0), data=STORED_BY_CIL),
        "unpacked",
        given=INTEGRALS,
        names="scale, offset",
        scale="2",
        offset="-50",
    ),
    "axes of CIL": read_as(
        cil(["vertical", "angle", "horizontal"]), "axes-stated", given=INTEGRALS, axes="rows,views,cells"
    ),
    "axes of Data Exchange": read_as(
        exchange((DATA, "axes", "y:theta:x"), data=STACK.swapaxes(0, 1)), "axes-stated", axes="rows,views,cells"
    ),
    "axes of NXdata": read_as(
        hdf5(
            {"scan/data": TURNED, "angles_deg": ANGLES},
            [("scan", "signal", "data"), ("scan", "axes", ["rotation_angle", "x", "y"])],
        ),
        "axes-stated",
        given=INTEGRALS,
        axes="views,cells,rows",
    ),
    "axes asked for": read_as(
        npz(projections=STACK.swapaxes(0, 1), flats=FLATS.swapaxes(0, 1), darks=DARKS[0], angles_deg=ANGLES),
        "axes-ordered",
        given={**COUNTS, "axes": "rows,views,cells"},
        axes="rows,views,cells",
    ),
    "axes asked for, fields in our order": read_as(
        npz(projections=STACK.transpose(1, 2, 0), flats=FLATS, darks=DARKS, angles_deg=ANGLES),
        "axes-ordered",
        given={**COUNTS, "axes": "rows,cells,views"},
    ),
    "axes asked for in NXtomo": read_as(
        exchange(data=TURNED, data_white=FLATS.transpose(0, 2, 1), data_dark=DARKS.transpose(0, 2, 1)),
        "axes-ordered",
        given={**COUNTS, "axes": "views,cells,rows"},
    ),
    "an array called dark": read_as(npz(**OF_NUMPY, dark=DARKS), "darks-by-name", arrays="dark (1, 3, 8)"),
    "one dark field without an axis of its own": read_as(
        npz(sino=STACK, flats=FLATS, darkField=DARKS[0], angles_deg=ANGLES), "darks-by-name", arrays="darkField (3, 8)"
    ),
    "flats before and after": read_as(
        exchange(data_white=None, data_white_pre=FLATS[:1], data_white_post=FLATS[1:]),
        "flats-by-name",
        arrays="data_white_post (1, 3, 8), data_white_pre (1, 3, 8)",
    ),
    "fields in groups": read_as(
        hdf5({"sinogram": STACK, "angles_deg": ANGLES, "flat/images": FLATS, "offset/images": DARKS}),
        "darks-by-name",
        arrays="offset/images (1, 3, 8)",
    ),
    "darks next to the stack of NXtomo": read_as(
        nxtomo(ANGLES, [3, *KEYS[1:], 3], dark_fields=DARKS), "darks-by-name", arrays="dark_fields (1, 3, 8)"
    ),
    "alignment images": read_as(
        nxtomo(np.r_[0, 0, 0, ANGLES, 9], [*KEYS, 0], image_key_control=[*KEYS, -1]),
        "alignment-images",
        images=1,
        key="image_key_control",
    ),
    "a control key alone": read_as(nxtomo(np.r_[0, 0, 0, ANGLES, 9], None, image_key_control=[*KEYS, 3])),
    "alignment images by the key itself": read_as(
        nxtomo(np.r_[0, 0, 0, ANGLES, 9], [*KEYS, -1]), "alignment-images", images=1, key="image_key"
    ),
    "angles of the views only": read_as(nxtomo(ANGLES, [*KEYS, 3]), "invalid-images", images=1),
    "given angles for another number": read_as(
        nxtomo(ANGLES[:4], [*KEYS, 3]), "angles-given", given={**COUNTS, "angles_deg": AngleList(tuple(ANGLES))}
    ),
    "pixels binned by two": read_as(
        exchange(x_pixel_size=1.6, x_binning=2), "binned", pixel_mm="1.6", binning=2, pitch_mm="3.2"
    ),
    "binning that is not clear": read_as(
        exchange(x_pixel_size=1.6, binning=[2, 1]), "length-ignored", path=f"{DETECTOR}/x_pixel_size"
    ),
    "cells of 320 mm": read_as(exchange(), "pitch-asked", given={**COUNTS, "detector_pitch_mm": 320.0}, pitch_mm=320.0),
    "numbers beside an array that may be its scale": read_as(
        npz(projections=PACKED - 1000, scale_factor=2e-5, angles_deg=ANGLES),
        "unused-values",
        given=INTEGRALS,
        arrays="scale_factor (2e-05)",
    ),
    # Honest files.
    "neutral scales": read_as(exchange((DATA, "scale_factor", 1.0), (DATA, "add_offset", 0), (DATA, "scale", 1))),
    "a scale of another program": read_as(exchange((DATA, "scale", 0.3), (DATA, "offset", [0, 0, 1]))),
    "usual axes": read_as(exchange((DATA, "axes", "theta:y:x"))),
    "usual axes of CIL": read_as(cil(["angle", "vertical", "horizontal"]), given=INTEGRALS),
    "binned by one": read_as(exchange(x_pixel_size=1.6, x_binning=1, y_binning=0)),
    "binned pixels whose size was given": read_as(
        exchange(x_pixel_size=1.6, x_binning=2), "binned", given={**COUNTS, "detector_pitch_mm": 1.6}
    ),
    "fields that belong to no line integrals": read_as(
        npz(projections=STACK, dark=DARKS, flat_pre=FLATS, angles_deg=ANGLES), given=INTEGRALS
    ),
    "other arrays": read_as(npz(**OF_NUMPY, darks=DARKS, white_oak=STACK, flat_corrected=STACK, offset=np.ones(2))),
    "a control key without alignment images": read_as(
        nxtomo(np.r_[0, 0, 0, ANGLES, 9], [*KEYS, 3], image_key_control=[*KEYS, 3]), "invalid-images"
    ),
}


@pytest.mark.parametrize("name", READ)
def test_a_file_is_read_rightly(tmp_path, name):
    write, options, code, values = READ[name]
    remarks, projections, angles, flats, darks, pitch = scan_of(write, tmp_path / "scan", **options)
    np.testing.assert_array_equal(projections, STACK)
    np.testing.assert_allclose(angles, ANGLES, rtol=1e-6)
    if options["counts"]:
        np.testing.assert_array_equal(flats, FLATS)
        np.testing.assert_array_equal(darks, DARKS)
    assert set(remarks) - {"axes-stated", "axes-ordered", "flats-by-name", "invalid-images"} <= {code}
    assert code is None or remarks[code].items() >= values.items()
    of_pixels = 3.2 if "binned" in remarks else 1.6 if "one" in name else None
    assert pitch in {None, options.get("detector_pitch_mm"), of_pixels}


CELL_ARRAY = [("#refs#/c0", "MATLAB_class", np.bytes_("double")), ("#refs#/c1", "MATLAB_class", np.bytes_("double"))]


def cell_array(path):
    """A cell array of MATLAB 7.3: references to datasets of a hidden group."""
    hdf5({"#refs#/c0": STACK.T, "#refs#/c1": STACK.T}, CELL_ARRAY)(path)
    with h5py.File(path, "r+") as file:
        file["proj"] = np.array([file["#refs#/c0"].ref, file["#refs#/c1"].ref], h5py.ref_dtype)[:, None]
        file["proj"].attrs["MATLAB_class"] = np.bytes_("cell")


REFUSED = {
    "a scale that is no number": (exchange((DATA, "scale_factor", "2e-5")), COUNTS),
    "a scale for each view": (exchange((DATA, "scale_factor", ANGLES)), COUNTS),
    "two conventions": (exchange((DATA, "scale_factor", 2), (DATA, "slope", 3)), COUNTS),
    "CIL's attributes of another writer": (exchange((DATA, "scale", 0.5), (DATA, "offset", 2), data=PACKED), COUNTS),
    "dark and flat fields that do not fit": (npz(projections=STACK, flat=FLATS[..., :5], angles_deg=ANGLES), COUNTS),
    "two flat fields of other meanings": (npz(projections=STACK, flat=FLATS, white=FLATS, angles_deg=ANGLES), COUNTS),
    "angles of the rows": (npz(projections=STACK.swapaxes(0, 1), angles_deg=ANGLES), INTEGRALS),
    "unnamed angles of the rows": (npz(projections=STACK.swapaxes(0, 1), theta=ANGLES), INTEGRALS),
    "an order that does not suit the angles": (
        npz(projections=STACK, angles_deg=ANGLES),
        {**INTEGRALS, "axes": "rows,cells,views"},
    ),
    "axes of another number": (npz(projections=STACK), {**INTEGRALS, "axes": "cells,views"}),
    "both options for axes": (npz(projections=STACK), {**INTEGRALS, "axes": "cells,rows,views", "transpose": True}),
    "too few angles in NXtomo": (nxtomo(ANGLES[:4], [*KEYS, 3]), COUNTS),
    "a cell array": (cell_array, INTEGRALS),
    "a cell array by its name": (cell_array, {**INTEGRALS, "dataset": "proj"}),
}


@each_refusal(Path(__file__).with_name("other_programs.txt"))
def test_a_file_is_refused(tmp_path, name, code, sentence):
    write, options = REFUSED[name]
    write(tmp_path / "scan")
    assert refusal(tmp_path / "scan", **options) == (code, sentence)


def test_dark_fields_are_missing_only_where_no_array_could_be_they(tmp_path):
    remarks, *_, darks, _ = scan_of(npz(**OF_NUMPY, dark=DARKS, offset=DARKS), tmp_path / "scan", counts=True)
    assert remarks == {"darks-unclear": {"arrays": "dark (1, 3, 8), offset (1, 3, 8)"}}
    assert darks is None


def test_the_only_contents_of_a_cell_are_read(tmp_path):
    write = hdf5({"#refs#/c0": STACK.T}, CELL_ARRAY[:1])
    assert np.array_equal(scan_of(write, tmp_path / "scan", **INTEGRALS, **IN_STEPS)[1], STACK)


TURN = np.arange(90) * 4.0 + 0.5


@pytest.mark.parametrize(
    ("angles", "unit", "codes"),
    [
        (np.deg2rad(TURN), "deg", {"radians-asked"}),
        (np.deg2rad(np.mod(TURN * 55.6230559, 360.0)), "deg", {"radians-asked"}),
        (np.deg2rad(np.arange(180) * 1.0), "deg", {"radians-asked"}),
        (TURN / 360.0, "deg", {"radians-asked"}),
        (TURN, "rad", {"degrees-asked"}),
        (TURN, "deg", set()),
        (np.deg2rad(TURN), "rad", set()),
        (np.deg2rad(TURN * 55.5), "rad", set()),
        (np.arange(90) * 0.5, "deg", set()),
        (np.arange(6) * 1.0, "deg", set()),
    ],
)
def test_a_unit_of_angles_that_cannot_be_right_is_asked_for(tmp_path, angles, unit, codes):
    write = exchange((THETA, "units", unit), data=np.ones((len(angles), 1, 8)), theta=angles, **FIELDS_APART)
    assert set(scan_of(write, tmp_path / "scan", **INTEGRALS)[0]) == codes


@pytest.mark.parametrize(
    ("shape", "step_deg", "option"),
    [
        ((768, 90), 4.0, "transpose"),
        ((24, 90, 70), 4.0, "axes=rows,views,cells"),
        ((6, 300, 12), 60.0, "axes=views,cells,rows"),
        ((90, 24, 70), 4.0, None),
        ((91, 90, 70), 4.0, None),
        ((400, 720), 0.5, None),
        ((45, 8), 4.0, None),
        ((90, 300, 70), 8.0, None),
    ],
)
def test_axes_that_may_be_others_are_asked_for(tmp_path, shape, step_deg, option):
    given = {**INTEGRALS, "angles_deg": AngleSteps(0.0, step_deg)}
    remarks, *_ = scan_of(npz(data=np.ones(shape, np.float32)), tmp_path / "scan", **given)
    options = [values["option"] for values in remarks.values() if "option" in values]
    assert len(options) == (option is not None)
    assert all(each.startswith(option) for each in options)
    assert len(remarks) < 2


def log(views=24, cells=96, noise=0.02):
    """Line integrals (views, 2, cells) of a log that leaves air at both ends, and of none in the second row."""
    chord = np.sqrt(np.clip(0.36 - np.linspace(-1.0, 1.0, cells) ** 2, 0.0, None))
    return (np.stack([chord, 0 * chord])[None] + noise * RNG.standard_normal((views, 2, cells))).astype(np.float32)


# A small log that comes into each cell in a few views only, and a beam that is brighter in the middle.
OFF_CENTRE = np.stack([np.roll(log(1)[0], shift, axis=-1) for shift in range(-16, 8)]).clip(0.0)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        (np.exp(-log()), "look like transmissions.* declare counts"),
        (20_000 * np.exp(-log()), "look like transmissions"),
        (np.rint(1e4 * OFF_CENTRE), None),
        (np.rint(1e4 * OFF_CENTRE + 1e3), None),
        (-log(), "their sign is wrong: multiply them by -1"),
        (-1000 * log(), "their sign is wrong"),
        (np.exp(-log(views=4)), "look like transmissions"),
        (log(), None),
        (log() - 0.5, None),
        (np.abs(log()[:, 1:]), None),
        (log()[:, 1:], None),
        (160.0 * log() + 3.3, None),
        (log()[..., 20:76], None),
        (log()[..., 30:66], None),
    ],
)
def test_numbers_that_are_no_line_integrals_are_refused(tmp_path, values, sentence):
    given = {**INTEGRALS, "angles_deg": AngleSteps(0.0, 15.0)}
    npz(data=values)(tmp_path / "scan")
    if sentence is None:
        assert read_scan(tmp_path / "scan", **given).shape[0] == 24
    else:
        refused(tmp_path / "scan", "contradiction", *sentence.split(".* "), **given)


@pytest.mark.parametrize(
    ("killed", "code", "sentence"), [(False, "file-in-use", "try again when"), (True, "broken-file", "h5clear")]
)
def test_a_file_that_its_writer_has_not_closed_is_not_damaged(tmp_path, killed, code, sentence):
    path = tmp_path / "scan.h5"
    script = (
        f"import h5py, sys; file = h5py.File({str(path)!r}, 'w', libver='latest'); file['a'] = 1; file.flush(); "
        "print(flush=True); sys.stdin.read()"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as writer:
        writer.stdout.readline()
        if killed:
            writer.kill()
            writer.wait()
        with pytest.raises(UnreadableScan, match=sentence) as refusal, library_errors_translated("HDF5"):
            open_hdf5(path)
        assert refusal.value.code == code
        assert "damaged" not in str(refusal.value)
