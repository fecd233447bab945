"""`sawmill inspect`: what is in a file, what would be read, what is missing; fields apart, linked HDF5 and folders."""

import json
from dataclasses import replace
from zipfile import ZipFile

import h5py
import numpy as np
import pytest
import scipy.io
import tifffile
from hostile import checkers, deflated_twice
from PIL import Image
from tests.support.exact_chords import full_turn

from sawmill_calibration.view_vectors import vectors_of
from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_worker.commands.geometry_options import theta_of

VIEWS, ROWS, CELLS = 12, 2, 8
COUNTS = np.random.default_rng(311).integers(1_000, 30_000, (VIEWS, ROWS, CELLS)).astype(np.uint16)
ANGLES = ("--angles-deg", "0:30")


def inspect(run, path, *flags):
    result = run("inspect", path, "--json", *flags)
    assert result.stdout.count("\n") == 1
    return json.loads(result.stdout)


def flags_of(answer, *, needed=True):
    return [part["flag"].split()[0] for part in answer["missing"] if part["needed"] is needed]


def parts_of(answer):
    return {part["name"]: part for part in answer["parts"]}


def test_a_scan_with_all_there_is_lacks_its_kind_only(run, stack):
    answer = inspect(run, stack)
    assert (answer["format"], answer["own_kind"], answer["verdict"]) == ("hdf5-nxtomo", None, "incomplete")
    assert answer["missing"][0]["flag"] == "--data counts"
    assert flags_of(answer, needed=False) == ["--source-to-cor-mm"]
    data = parts_of(answer)["/entry/data/data"]
    assert (data["type"], data["compression"]) == ("uint16", "shuffle, deflate")
    assert 0 < data["stored_bytes"] < 2 * np.prod(data["shape"])
    assert parts_of(answer)["/entry/data/rotation_angle"]["unit"] == "deg"
    assert parts_of(answer)["/entry/instrument/detector/data"]["leads_to"] == "/entry/data/data"


def test_what_would_be_read_is_what_is_read(run, stack):
    answer = inspect(run, stack, "--data", "counts")
    assert (answer["verdict"], answer["refusal"]) == ("ready", None)
    reading = answer["reading"]
    assert reading["shape"] == {"views": 60, "rows": 4, "detector": 256}
    assert (reading["flats"], reading["darks"]) == (10, 10)
    angles = reading["angles"]
    assert (angles["first_deg"], angles["last_deg"]) == (pytest.approx(3.0), pytest.approx(357.0))
    assert (angles["from_file"], angles["file_unit"]) == (True, "deg")
    assert reading["detector_pitch_mm"] == pytest.approx(4.508593749)


def test_our_own_scan_volume_and_calibration(run, phantom_scan, result_hdf5, tmp_path):
    scan = inspect(run, phantom_scan)
    assert (scan["own_kind"], scan["missing"][0]["flag"]) == ("scan", "--data line-integrals")
    calibration = inspect(run, result_hdf5)
    assert calibration["own_kind"] == "calibration"
    assert "--calibration" in calibration["refusal"]["detail"]
    with h5py.File(result_hdf5) as file:
        document = json.loads(file["entry/calibration_json"][()]) | {"state": "succeeded"}
    for identifier, known in (("c1", "c1"), ("../c1", None), (1, None)):
        (tmp_path / "result.json").write_text(json.dumps(document | {"id": identifier}))
        answer = inspect(run, tmp_path / "result.json")
        assert (answer["own_kind"], answer["refusal"]["code"]) == ("calibration", "calibration-file")
        assert answer["calibration_id"] == known
    volume = tmp_path / "volume.h5"
    known = ("--data", "line-integrals", "--calibration", result_hdf5, "--size", 16, "--rows", "0:1", "--method", "fbp")
    run("reconstruct", phantom_scan, *known, "-o", volume)
    answer = inspect(run, volume)
    assert (answer["own_kind"], answer["verdict"]) == ("volume", "refused")
    assert "volume" in answer["refusal"]["detail"]
    assert parts_of(answer)["/entry/data/data"]["shape"] == [1, 16, 16]
    assert parts_of(answer)["/VTKHDF/PointData/attenuation"]["leads_to"].startswith("virtual, of ")


def test_a_list_of_vectors_is_named_with_the_numbers_by_which_a_scanner_starts(run, tmp_path):
    scanner, theta = Scanner(859.46, 288, 4.0), Theta(0.7, 715.0, 40.0, 10.0, 0.05)
    turned = FanBeamGeometry(scanner, theta, -full_turn(40))
    (tmp_path / "views.json").write_text(json.dumps(vectors_of(turned)))
    np.save(tmp_path / "rows.npy", turned.astra_vectors())
    for name in ("views.json", "rows.npy"):
        refusal = inspect(run, tmp_path / name)["refusal"]
        assert refusal["code"] == "geometry-file"
        numbers, how = refusal["detail"].split("--theta ")[1].split(" ", 1)
        assert how == "--rotation reversed, source to turning axis 860.3903135 mm, cells of 4 mm"
        assert vars(theta_of(numbers).source_frame(860.3903135)) == pytest.approx(vars(turned.frame), abs=1e-6)
    arc = FanBeamGeometry(replace(scanner, detector_arc_radius_mm=1500.0), theta, full_turn(40))
    (tmp_path / "views.json").write_text(json.dumps(vectors_of(arc)))
    assert "from equal distances on a straight line" in inspect(run, tmp_path / "views.json")["refusal"]["detail"]


def test_a_matlab_struct_shows_its_fields_and_the_values_that_could_serve(run, tmp_path):
    path = tmp_path / "published.mat"
    parameters = {"distanceSourceOrigin": 410.66, "angles": np.arange(VIEWS)}
    scipy.io.savemat(path, {"Ct": {"sinogram": COUNTS[:, 0] / 1e4, "parameters": parameters}}, do_compression=True)
    answer = inspect(run, path, "--data", "line-integrals")
    assert parts_of(answer)["Ct/sinogram"]["shape"] == [VIEWS, CELLS]
    assert answer["reading"]["unused"] == "Ct/parameters/distanceSourceOrigin (410.66)"
    assert flags_of(answer) == ["--angles-deg", "--detector-pitch-mm"]
    [distance] = (part for part in answer["missing"] if part["flag"] == "--source-to-cor-mm")
    assert "distanceSourceOrigin (410.66)" in distance["why"]


def npz_of(path):
    np.savez_compressed(path, projections=COUNTS, flats=COUNTS[:2], angles_deg=30.0 * np.arange(VIEWS))


def zip_of(path):
    with ZipFile(path, "w") as archive:
        for index, image in enumerate(COUNTS):
            tifffile.imwrite(path.with_suffix(".tif"), image)
            archive.write(path.with_suffix(".tif"), f"flat-{index}.tif" if index < 2 else f"view-{index}.tif")


def exchange_of(path):
    with h5py.File(path, "w") as file:
        file["exchange/data"], file["exchange/data_white"] = COUNTS, COUNTS[:2]
        file["exchange/theta"] = 30.0 * np.arange(VIEWS)


@pytest.mark.parametrize(
    ("name", "write", "form", "part", "flags"),
    [
        ("s.npy", lambda path: np.save(path, COUNTS), "npy", "the array", ["--angles-deg", "--flats"]),
        ("s.npz", npz_of, "npz", "projections", []),
        ("s.tif", lambda path: tifffile.imwrite(path, COUNTS, metadata=None), "tiff", "page 0 to page 11",
         ["--angles-deg", "--flats"]),
        ("s.zip", zip_of, "zip-of-tiffs", "view-2.tif to view-11.tif", ["--angles-deg"]),
        ("s.h5", exchange_of, "hdf5-data-exchange", "/exchange/data", []),
    ],
)  # fmt: skip
def test_every_format_is_listed_with_what_is_missing(run, tmp_path, name, write, form, part, flags):
    write(tmp_path / name)
    answer = inspect(run, tmp_path / name, "--data", "counts")
    assert answer["format"] == form
    assert part in parts_of(answer)
    assert flags_of(answer) == [*flags, "--detector-pitch-mm"]
    assert answer["size_bytes"] == (tmp_path / name).stat().st_size


def test_pages_that_are_alike_are_one_line(run, tmp_path):
    tifffile.imwrite(tmp_path / "s.tif", COUNTS, metadata=None)
    [pages] = inspect(run, tmp_path / "s.tif")["parts"]
    assert (pages["count"], pages["shape"], pages["stored_bytes"]) == (VIEWS, [ROWS, CELLS], COUNTS.nbytes)
    shown = run("inspect", tmp_path / "s.tif").stdout
    assert f"{VIEWS} pages, each {ROWS} x {CELLS} uint16" in shown
    assert "missing: detector pitch (--detector-pitch-mm)" in shown


def test_given_flags_make_a_scan_complete(run, tmp_path):
    np.save(tmp_path / "views.npy", COUNTS)
    np.save(tmp_path / "air.npy", np.full((ROWS, CELLS), 30_000, np.uint16))
    given = ("--data", "counts", *ANGLES, "--detector-pitch-mm", 1.5, "--flats", tmp_path / "air.npy")
    answer = inspect(run, tmp_path / "views.npy", *given)
    assert (answer["verdict"], answer["reading"]["flats"]) == ("ready", 1)
    assert answer["reading"]["other_files"] == [str(tmp_path / "air.npy")]
    assert flags_of(answer, needed=False) == ["--row-pitch-mm", "--darks", "--source-to-cor-mm"]


@pytest.mark.parametrize(
    ("flags", "code"),
    [
        (("--data", "line-integrals"), "contradiction"),
        (("--angles-deg", "5:30"), "contradiction"),
        (("--dataset", "nothing"), "dataset-missing"),
    ],
)
def test_what_would_be_refused_is_said_with_its_reason(run, tmp_path, flags, code):
    npz_of(tmp_path / "s.npz")
    answer = inspect(run, tmp_path / "s.npz", *flags)
    assert (answer["verdict"], answer["refusal"]["code"]) == ("refused", code)
    assert parts_of(answer)["flats"]["shape"] == [2, ROWS, CELLS]


def test_several_candidates_are_missing_a_choice(run, tmp_path):
    np.savez(tmp_path / "s.npz", a=COUNTS, b=COUNTS)
    answer = inspect(run, tmp_path / "s.npz")
    assert answer["verdict"] == "incomplete"
    assert flags_of(answer) == ["--dataset"]


def test_sinograms_are_read_in_the_order_that_is_given_and_darks_by_a_similar_name(run, tmp_path):
    flats = np.full((1, ROWS, CELLS), 40_000)
    np.savez(tmp_path / "scan.npz", projections=COUNTS.swapaxes(0, 1), flats=flats, dark=flats)
    reading = inspect(run, tmp_path / "scan.npz", "--data", "counts", "--axes", "rows,views,cells", *ANGLES)["reading"]
    assert reading["shape"] == {"views": VIEWS, "rows": ROWS, "detector": CELLS}
    assert [remark["code"] for remark in reading["coded_remarks"]] == ["darks-by-name", "axes-ordered"]
    assert reading["darks"] == 1


def test_a_picture_and_a_text(run, tmp_path):
    Image.new("L", (20, 10)).save(tmp_path / "phantom.png")
    picture = inspect(run, tmp_path / "phantom.png")
    assert picture["parts"][0]["shape"] == [10, 20]
    assert "--phantom" in picture["refusal"]["detail"]
    (tmp_path / "notes.txt").write_text("angles as last time")
    answer = inspect(run, tmp_path / "notes.txt")
    assert (answer["format"], answer["parts"], answer["refusal"]["code"]) == (None, [], "unknown-format")
    assert "refused" in run("inspect", tmp_path / "notes.txt").stdout


def test_links_are_shown_and_not_followed(run, tmp_path):
    with h5py.File(tmp_path / "master.h5", "w") as file:
        file["data"] = h5py.ExternalLink("elsewhere.h5", "/x")
        file["here"] = h5py.SoftLink("/nowhere")
    answer = inspect(run, tmp_path / "master.h5")
    assert parts_of(answer)["/data"]["leads_to"] == "file elsewhere.h5:/x (not there)"
    assert parts_of(answer)["/here"]["leads_to"] == "/nowhere"
    assert answer["verdict"] != "ready"


def test_hostile_files_are_listed_from_their_headers(run, tmp_path):
    deflated_twice(tmp_path / "twice.h5", 2**24)
    answer = inspect(run, tmp_path / "twice.h5")
    assert parts_of(answer)["/data"]["compression"] == "deflate, deflate"
    assert answer["refusal"]["code"] == "unsupported-storage"
    checkers(tmp_path / "checkers.png")
    assert inspect(run, tmp_path / "checkers.png")["parts"][0]["shape"] == [6400, 6400]
    with h5py.File(tmp_path / "many.h5", "w") as file:
        for index in range(10_001):
            file.create_group(str(index))
    many = inspect(run, tmp_path / "many.h5")
    assert many["refusal"]["code"] == "too-large"
    assert "more than 10000" in many["listing_ended"]
    (tmp_path / "broken.h5").write_bytes((tmp_path / "many.h5").read_bytes()[:5_000])
    assert inspect(run, tmp_path / "broken.h5")["refusal"]["code"] in {"truncated-file", "broken-file"}


THETA = "2.55,714.7,319.9,43.7,0.281"
PITCH = ("--detector-pitch-mm", 4.508593749)
GEOMETRY = ("--source-to-cor-mm", 859.46, "--theta", THETA, "--size", 32, "--rows", "2:3")


@pytest.fixture(scope="session")
def parts(scans, stack):
    """Views, flats and darks of the stack, each in a file of its own, and its flags for the angles."""
    with h5py.File(stack) as file:
        detector = file["entry/instrument/detector"]
        images, keys = detector["data"][()], detector["image_key"][()]
        angles = file["entry/sample/rotation_angle"][()][keys == 0]
    for name, key in (("views", 0), ("flats", 1), ("darks", 2)):
        np.save(scans / f"{name}.npy", images[keys == key])
    (scans / "angles.txt").write_text("\n".join(f"{angle:.12g}" for angle in angles))
    return scans


def test_fields_that_are_missing_do_not_exist_or_are_in_both_places_are_refused(
    failure, parts, tmp_path, wrong_use, stack
):
    given = (*GEOMETRY, "--data", "counts", "-o", tmp_path / "out.h5", "--angles-file", parts / "angles.txt")
    answer = failure("reconstruct", parts / "views.npy", *given, *PITCH)
    assert answer["code"] == "flats-missing"
    assert "(--flats)" in answer["detail"]
    flags = ("--data", "counts", *GEOMETRY, "-o", "out.h5")
    assert "'--flats'" in wrong_use("reconstruct", stack, *flags, "--flats", "nowhere.tif")
    given = ("--data", "counts", *GEOMETRY, "-o", tmp_path / "out.h5", "--flats", parts / "flats.npy")
    answer = failure("reconstruct", stack, *given)
    assert answer["code"] == "contradiction"
    assert json.dumps(answer).count("--flats") == 1


@pytest.fixture(scope="session")
def master(scans, stack):
    """An NXtomo file whose images and angles lie in another one."""
    with h5py.File(scans / "master.h5", "w") as file:
        for name in ("definition", "instrument", "sample"):
            file[f"entry/{name}"] = h5py.ExternalLink(stack.name, f"/entry/{name}")
    return scans / "master.h5"


def test_without_the_flag_the_refusal_names_it(failure, run, master, tmp_path):
    answer = failure("reconstruct", master, *GEOMETRY, "--data", "counts", "-o", tmp_path / "out.h5")
    assert answer["code"] == "external-storage"
    assert answer["detail"].endswith("--follow-links")
    inspected = json.loads(run("inspect", master, "--data", "counts", "--json").stdout)
    assert inspected["verdict"] == "incomplete"
    assert [part["flag"] for part in inspected["missing"]] == ["--follow-links"]


def test_inspect_follows_links_and_names_what_is_not_there(run, master, stack, tmp_path):
    answer = json.loads(run("inspect", master, "--data", "counts", "--follow-links", "--json").stdout)
    assert answer["verdict"] == "ready"
    assert answer["reading"]["other_files"] == [str(stack)]
    alone = tmp_path / "alone.h5"
    alone.write_bytes(master.read_bytes())
    answer = json.loads(run("inspect", alone, "--follow-links", "--json").stdout)
    assert answer["refusal"]["code"] == "linked-file-missing"
    assert stack.name in answer["refusal"]["detail"]
    assert {part["leads_to"] for part in answer["parts"]} >= {f"file {stack.name}:/entry/sample (not there)"}


def test_inspect_a_folder(run, parts, tmp_path):
    folder = tmp_path / "views"
    folder.mkdir()
    for index, image in enumerate(np.load(parts / "views.npy")):
        tifffile.imwrite(folder / f"image-{index}.tif", image)
    (folder / "notes.txt").write_text("nothing of the scan")
    answer = json.loads(run("inspect", folder, "--json", "--data", "counts").stdout)
    assert (answer["format"], answer["verdict"]) == ("folder-of-tiffs", "incomplete")
    images, notes = answer["parts"]
    assert (images["name"], images["count"]) == ("image-0.tif to image-59.tif", 60)
    assert (images["shape"], images["type"]) == ([4, 256], "uint16")
    assert (notes["name"], notes["type"]) == ("notes.txt", "txt")
    assert [part["flag"] for part in answer["missing"] if part["needed"]] == [
        "--angles-deg or --angles-file", "--flats", "--detector-pitch-mm",
    ]  # fmt: skip
    assert "1 files that are no TIFFs were ignored (notes.txt)." in answer["reading"]["remarks"]
    assert answer["size_bytes"] == sum(each.stat().st_size for each in folder.iterdir())
