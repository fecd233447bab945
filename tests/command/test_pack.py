"""`sawmill pack`: the packed scan calibrates as the scan does, and says nothing of anybody."""

import json
import re
import shutil

import h5py
import numpy as np
import pytest
import scipy.io
import tifffile
from typer.testing import CliRunner

from sawmill_command.commands import main
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS
from sawmill_formats.output.scan_writer import new_scan
from sawmill_vocabulary import DetectorModule

PLACE = ("--source-to-cor-mm", 859.46)
PEOPLE, DAY, SERIAL, NUMBER, PATH = "Erkki Esimerkki", "2031-04-05T06:07:08", "SN-77A", 48213907, "/srv/mill/line-2"
VIEWS, ROWS, CELLS = 12, 2, 16
COUNTS = np.random.default_rng(56).integers(1_000, 30_000, (VIEWS, ROWS, CELLS)).astype(np.uint16)
FLATS, DARKS = np.full((2, ROWS, CELLS), 40_000, np.uint16), np.full((1, ROWS, CELLS), 90, np.uint16)
ANGLES = 30.0 * np.arange(VIEWS)


def nxtomo(folder):
    path = folder / f"{SERIAL}.nxs"
    with h5py.File(path, "w") as file:
        file.attrs["file_name"], file.attrs["creator"] = f"{PATH}/{SERIAL}.nxs", PEOPLE
        entry = file.create_group("entry")
        entry["definition"], entry["title"], entry["start_time"] = "NXtomo", f"log of {PEOPLE}", DAY
        entry["user/name"], entry["sample/name"], entry["sample/barcode"] = PEOPLE, SERIAL, NUMBER
        detector = entry.create_group("instrument/detector")
        detector.attrs["serial_number"] = NUMBER
        detector["serial_number"], detector["count_time"] = SERIAL, np.full(15, 0.25)
        detector["data"] = np.concatenate([DARKS, FLATS, COUNTS])
        detector["data"].attrs["source"] = PATH
        detector["image_key"] = [2, 1, 1, *[0] * VIEWS]
        detector["x_pixel_size"] = 1.5
        detector["x_pixel_size"].attrs["units"] = "mm"
        entry["sample/rotation_angle"] = np.concatenate([np.zeros(3), ANGLES])
        entry["sample/rotation_angle"].attrs["units"] = "deg"
        entry[SERIAL] = h5py.SoftLink(PATH)
    return path


def exchange(folder):
    path = folder / "scan.h5"
    with h5py.File(path, "w") as file:
        file["exchange/data"], file["exchange/data_white"], file["exchange/data_dark"] = COUNTS, FLATS, DARKS
        file["exchange/theta"], file["implements"] = ANGLES, f"exchange:{PATH}"
        file["exchange/data"].attrs["description"] = PEOPLE
        file["measurement/sample/experimenter/name"] = np.array([PEOPLE, SERIAL], h5py.string_dtype())
        file["measurement/instrument/detector/serial_number"], file["measurement/sample/name"] = NUMBER, SERIAL
        file["process/date"] = np.bytes_(DAY)
    return path


def tiffs(folder):
    scan = folder / f"scan-{SERIAL}"
    scan.mkdir()
    for name, stack in (("flat", FLATS), ("dark", DARKS), ("view", COUNTS)):
        for number, image in enumerate(stack):
            tags = [(315, "s", 0, PEOPLE, True), (50735, "s", 0, SERIAL, True), (65000, "I", 1, NUMBER, True)]
            description = {"description": f"{PATH} {DAY}", "software": PEOPLE, "datetime": "2031:04:05 06:07:08"}
            tifffile.imwrite(scan / f"{name}_{number:03d}.tif", image, extratags=tags, metadata=None, **description)
    (scan / "settings.json").write_text(json.dumps({"operator": PEOPLE, "date": DAY, "serial": NUMBER}))
    return scan


def arrays(folder):
    scan = {"data": COUNTS, "flats": FLATS, "darks": DARKS, "operator": PEOPLE, "serial": NUMBER, "gain": 1.5}
    scipy.io.savemat(folder / "scan.mat", scan | {"date": DAY, "folder": f"{PATH}/{SERIAL}"})
    return folder / "scan.mat"


@pytest.mark.parametrize("written", [nxtomo, exchange, tiffs, arrays])
def test_nothing_private_is_in_the_packed_file_and_all_of_it_is_shown(written, run, tmp_path):
    scan = written(tmp_path)
    beside = scan.with_suffix(".json")
    beside.write_text(json.dumps({"operator": PEOPLE, "path": PATH}))
    drawing = {"name": PEOPLE, "shapes": [{"kind": "disc", "center_mm": [0, 0], "radius_mm": 9.0, "density": 1.0}]}
    measured = {"dimension": SERIAL, "measured_mm": 18.0, "standard_uncertainty_mm": 0.1, "instrument": SERIAL}
    (tmp_path / "drawing.json").write_text(
        json.dumps(drawing | {"measurements": [measured | {"measured_on": "2025-11-02"}]})
    )
    given = ("--data", "counts", "--phantom", tmp_path / "drawing.json", *PLACE)
    given += () if written is nxtomo else ("--detector-pitch-mm", 1.5)
    given += ("--angles-deg", "0:30") if written in {tiffs, arrays} else ()
    answer = json.loads(run("pack", scan, *given, "-o", tmp_path / "packed.h5", "--yes", "--json").stdout)
    shown = json.dumps(answer["left_out"])
    text = (tmp_path / "packed.h5").read_bytes()
    for secret in (PEOPLE, SERIAL, PATH, str(tmp_path), scan.name, "mill", "operator"):
        assert all(secret.encode(code) not in text for code in ("utf-8", "utf-16-le", "utf-32-le"))
    for kind in (np.int32, np.int64, np.float32, np.float64):
        assert kind(NUMBER).tobytes() not in text
    assert not re.search(rb"20\d\d.[01]\d.[0-3]\d", text)
    # The listing of a MATLAB file has the names of its variables alone.
    found = ("operator", "serial", "date", "gain") if written is arrays else (PEOPLE, SERIAL, str(NUMBER), PATH)
    assert all(text in shown for text in (scan.name, beside.name, *found))
    with h5py.File(tmp_path / "packed.h5") as file:
        assert np.array_equal(file["entry/data/data"], np.concatenate([DARKS, FLATS, COUNTS]))
        assert file["entry/given/source_to_cor_mm"][()] == PLACE[1]


def calibrated(run, scan, phantom, *flags):
    answer = json.loads(run("calibrate", scan, "--phantom", phantom, *flags, *PLACE, "--json").stdout)
    own = ("id", "timing_s", "phantom", "phantom_drawing", "input_sha256", "created_at")
    return {name: value for name, value in answer.items() if name not in own}


@pytest.mark.parametrize("kind", ["counts", "prepared", "array"])
def test_a_packed_scan_calibrates_to_the_same_digits(kind, run, stack, phantom_scan, bare_scan, tmp_path):
    scan = {"counts": stack, "prepared": phantom_scan, "array": bare_scan}[kind]
    data = ("--data", "counts" if kind == "counts" else "line-integrals")
    given = ("--angles-deg", "3.1:6", "--detector-pitch-mm", 4.508593749) if kind == "array" else ()
    packed, drawing, rows = tmp_path / "packed.h5", tmp_path / "l.json", ("--rows", "0:2")
    drawing.write_text(BUILT_IN_PHANTOMS["l-shape"].model_dump_json())
    run("pack", scan, *data, *given, *PLACE, "--phantom", drawing, "-o", packed, "--yes")
    assert calibrated(run, packed, packed, *data, *rows) == calibrated(run, scan, "l-shape", *data, *given, *rows)
    missing = json.loads(run("inspect", packed, *data, "--json").stdout)["missing"]
    assert "source_to_cor_mm (859.46)" in missing[-1]["why"]


def prepared(path, air_level=None, modules=()):
    about = {"angles_rad": np.deg2rad(ANGLES), "detector_pitch_mm": 1.5, "row_pitch_mm": None}
    with new_scan(path, COUNTS.shape, **about, detector_modules=modules, detector_arc_radius_mm=1e3) as written:
        written.data[...] = 1.0
        written.note(air_level=air_level, provenance={"scan": PEOPLE})
    return path, "--data", "line-integrals", "-o", path.with_name("packed.h5"), "--yes"


def test_a_scan_that_was_prepared_from_counts_is_refused(failure, tmp_path):
    line = prepared(tmp_path / "scan.h5", air_level=np.full((ROWS, CELLS), 900.0, np.float32))
    assert failure("pack", *line)["code"] == "scan-refused"


def test_modules_and_arc_of_the_detector_are_kept(run, tmp_path):
    shown = run(
        "pack", *prepared(tmp_path / "scan.h5", modules=(DetectorModule(first_cell=8, gap_mm=0.7, kink_rad=0.01),))
    )
    assert PEOPLE.encode() not in (tmp_path / "packed.h5").read_bytes()
    assert "detector_arc_radius_mm: 1000" in shown.stdout + shown.stderr
    reading = json.loads(run("inspect", tmp_path / "packed.h5", "--json").stdout)["reading"]
    assert reading["detector_arc_radius_mm"] == 1000.0
    (module,) = reading["detector_modules"]
    assert module == pytest.approx({"first_cell": 8, "gap_mm": 0.7, "kink_rad": 0.01}, abs=1e-12)


def test_the_lists_are_shown_before_anything_is_written(stack, failure, tmp_path):
    scan, packed = shutil.copy(stack, tmp_path / "scan.h5"), tmp_path / "packed.h5"
    line = ["pack", str(scan), "--data", "counts", "-o", str(packed)]
    refused = CliRunner().invoke(main, line, input="n\n", terminal_width=200)
    assert (refused.exit_code, packed.exists()) == (1, False)
    for words in ("60 views x 4 rows x 256 cells", "scan.h5", "start_time", "not known: source_to_cor_mm"):
        assert words in refused.stdout
    assert (failure(*line)["code"], packed.exists()) == ("not-confirmed", False)
    assert CliRunner().invoke(main, line, input="y\n").exit_code == 0
    assert packed.exists()


def test_a_scan_is_not_packed_onto_itself(stack, wrong_use):
    assert "is the scan itself" in wrong_use("pack", stack, "--data", "counts", "-o", stack)
