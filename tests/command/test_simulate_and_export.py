"""`sawmill simulate`, `sawmill export`, `sawmill phantom plan` and `sawmill phantom draw`."""

import json
import math
import xml.etree.ElementTree as ET
from dataclasses import replace

import h5py
import numpy as np
import pytest
from PIL import Image

import sawmill_calibration as sawmill
from sawmill_calibration import InputError
from sawmill_contracts.plans import PlanResult
from sawmill_tomography.geometry.export import cil_arguments, odl_arguments, rtk_arguments
from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_vocabulary import Rotation
from sawmill_worker.commands.export import rtk_xml

TRUTH = Theta(2.55, 714.7, 319.9, 43.7, 0.281)
SCANNER = Scanner(859.46, 256, 4.508593749)
SLIPPED = {"motion": {"slip_mm": 20.0, "slip_at": 0.5}, "detector": {"bits": 12}}
THETA = ("--theta", "2.55,714.7,319.9,43.7,0.281")
SMALL = ("--detector-pixels", 256, "--detector-pitch-mm", 4.508593749, "--views", 12)
EXACT = ("--data", "line-integrals", *THETA, *SMALL)


def frames(path, key: int = 0) -> np.ndarray:
    with h5py.File(path) as file:
        detector = file["entry/instrument/detector"]
        return detector["data"][()][detector["image_key"][()] == key]


def expected(angles, phantom=L_SHAPE) -> np.ndarray:
    fan = FanBeamGeometry(SCANNER, TRUTH, angles)
    return project(phantom, DetectorCells.of(SCANNER), fan.frame, fan.angles_rad, rays_per_cell=8)


def turn(views: int) -> np.ndarray:
    return (np.arange(views) + 0.5) * 2 * np.pi / views


def test_line_integrals_are_the_analytic_projection(run, tmp_path):
    run("simulate", "l-shape", *EXACT, "-o", tmp_path / "out.h5")
    assert np.allclose(frames(tmp_path / "out.h5")[:, 0], expected(turn(12)), atol=1e-3)


def test_handedness_rotation_and_position_are_taken(run, tmp_path):
    flags = ("--handedness", "from-behind", "--rotation", "reversed", "--position-mm", "5,-3")
    run("simulate", "l-shape", *EXACT, *flags, "-o", tmp_path / "out.h5")
    seen = L_SHAPE.mirrored().moved(5.0, -3.0)
    assert np.allclose(frames(tmp_path / "out.h5")[:, 0], expected(Rotation.REVERSED.apply(turn(12)), seen), atol=1e-3)


def test_noise_and_background_are_seeded(run, tmp_path):
    flags = (*EXACT, "--noise", 0.02, "--background", 3, "--seed", 4)
    for name in ("first", "second"):
        run("simulate", "l-shape", *flags, "-o", tmp_path / f"{name}.h5")
    first, second = (frames(tmp_path / f"{name}.h5")[:, 0] for name in ("first", "second"))
    clean = expected(turn(12))
    assert np.array_equal(first, second)
    assert np.mean(first - clean) == pytest.approx(3.0, abs=0.2)
    assert np.std(first - clean) == pytest.approx(0.02 * np.sqrt(np.mean(clean**2)), rel=0.05)


def test_counts_carry_flats_darks_angles_and_pitches(run, tmp_path):
    run("simulate", "log-with-phantom", *THETA, *SMALL, "--rows", 3, "--phantom-rows", 1, "-o", tmp_path / "out.h5")
    assert frames(tmp_path / "out.h5").shape == (12, 3, 256)
    assert frames(tmp_path / "out.h5", 1).mean() > 100 * frames(tmp_path / "out.h5", 2).mean()
    with h5py.File(tmp_path / "out.h5") as file:
        assert file["entry/instrument/detector/x_pixel_size"][()] == 4.508593749
        assert file["entry/instrument/detector/y_pixel_size"][()] == 2.0


def test_angles_and_a_pictured_phantom_may_be_given(run, tmp_path):
    Image.fromarray(np.rint(255 * L_SHAPE.rasterise(800, 400.0)).astype(np.uint8)).save(tmp_path / "l.png")
    flags = ("--phantom-width-mm", 400, "--angles-deg", "10:20")
    run("simulate", tmp_path / "l.png", *EXACT, *flags, "-o", tmp_path / "out.h5")
    mass = expected(np.deg2rad(10 + 20 * np.arange(12))).sum(axis=1)
    assert np.allclose(frames(tmp_path / "out.h5")[:, 0].sum(axis=1), mass, rtol=2e-3)


def test_a_log_alone_has_no_phantom(run, tmp_path):
    run("simulate", "log", *EXACT, "-o", tmp_path / "out.h5")
    assert 1.0 < frames(tmp_path / "out.h5").max() < 10.0


@pytest.mark.parametrize(
    ("body", "flags", "complaint"),
    [
        ("cube", (), "'BODY': must be l-shape"),
        ("l-shape", ("--position-mm", "5"), "'--position-mm': must be X,Y"),
        ("log-with-phantom", ("--rows", 4), "leaves no row for the log"),
        ("l-shape", ("--angles-deg", "x"), "an angle must be"),
        ("l-shape", ("--noise", -1), "--noise"),
    ],
)
def test_wrong_use_is_refused(wrong_use, tmp_path, body, flags, complaint):
    assert complaint in wrong_use("simulate", body, *EXACT, *flags, "-o", tmp_path / "out.h5")


def test_an_impossible_geometry_is_refused(run, tmp_path):
    flags = ("--theta", "0,700,0,0,10", *SMALL, "--data", "line-integrals", "-o", tmp_path / "x.h5")
    assert run("simulate", "l-shape", *flags, code=1).stderr.startswith("geometry: ")


@pytest.fixture
def physics_file(tmp_path):
    def write(content: object):
        path = tmp_path / "physics.json"
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path

    return write


def test_counts_show_what_the_file_names(run, tmp_path, physics_file):
    """Nothing until the slip in the middle; then 20 mm, some eight cells, at the shadow's edges. Twelve bits."""
    for name, content in (("still", {"detector": {"bits": 12}}), ("slipped", SLIPPED)):
        flags = ("--physics", physics_file(content), *THETA, *SMALL, "--rows", 2)
        run("simulate", "l-shape", *flags, "-o", tmp_path / f"{name}.h5")
    still, slipped = (frames(tmp_path / f"{name}.h5").astype(float) for name in ("still", "slipped"))
    assert still.shape == slipped.shape == (12, 2, 256)
    assert np.array_equal(still[:6], slipped[:6])
    assert (np.abs(still - slipped)[6:].max(axis=(1, 2)) > 500).all()
    assert slipped.max() <= 4095
    assert len(frames(tmp_path / "slipped.h5", 1)) == 10


def test_python_reads_the_same_scan(run, tmp_path, physics_file):
    path = physics_file(SLIPPED)
    run("simulate", "l-shape", "--physics", path, *THETA, *SMALL, "-o", tmp_path / "out.h5")
    read = sawmill.read_scan(tmp_path / "out.h5", data="counts", source_to_cor_mm=859.46)
    for physics in (SLIPPED, path):
        made = sawmill.simulate_phantom_scan("l-shape", SCANNER, TRUTH, views=12, physics=physics)
        np.testing.assert_array_equal(made.line_integrals, read.line_integrals)
        assert made.from_counts


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ({"beam": {"blur": 1}}, "beam.blur: Extra inputs are not permitted"),
        ({"motion": {"slip_mm": -1}}, "motion.slip_mm: Input should be greater than or equal to 0"),
        ({"detector": {"bits": 14}}, "detector.bits: Input should be 12 or 16"),
        ("slip", "Invalid JSON"),
    ],
)
def test_what_is_no_physics_is_refused(run, tmp_path, physics_file, content, complaint):
    flags = ("--physics", physics_file(content), *THETA, *SMALL, "-o", tmp_path / "out.h5")
    assert complaint in run("simulate", "l-shape", *flags, code=1).output
    assert not (tmp_path / "out.h5").exists()


def test_physics_are_of_counts(wrong_use, tmp_path, physics_file):
    flags = ("--physics", physics_file({}), "--data", "line-integrals", *THETA, *SMALL, "-o", tmp_path / "out.h5")
    assert "--physics makes counts: leave --data line-integrals out." in wrong_use("simulate", "l-shape", *flags)
    with pytest.raises(InputError, match="give physics, or noise and background, not both"):
        sawmill.simulate_phantom_scan("l-shape", SCANNER, TRUTH, physics={}, noise=0.1)
    with pytest.raises(InputError, match=r"wood\.rings: Extra inputs"):
        sawmill.simulate_phantom_scan("l-shape", SCANNER, TRUTH, physics={"wood": {"rings": 3}})


def calibrated(result_file, angles_deg) -> FanBeamGeometry:
    return FanBeamGeometry(SCANNER, Theta(**json.loads(result_file.read_text())["theta"]), np.deg2rad(angles_deg))


def test_export_writes_the_vectors_of_astra(run, result_file, tmp_path):
    flags = ("--views", 12, "--angles-deg", "15:30", "-o", tmp_path / "out.txt")
    run("export", "--to", "astra", "--calibration", result_file, *flags)
    fan = calibrated(result_file, 15 + 30 * np.arange(12))
    assert np.allclose(np.loadtxt(tmp_path / "out.txt"), fan.astra_vectors(), rtol=1e-10)


def test_vectors_on_an_arc_give_images_and_drift_checks(run, tmp_path):
    arc, scan = ("--detector-arc-radius-mm", 1500), ("--data", "line-integrals")
    run("simulate", "l-shape", *scan, *THETA, *SMALL, *arc, "--views", 60, "--noise", 0.01, "-o", tmp_path / "scan.h5")
    given = (tmp_path / "scan.h5", *scan, "--source-to-cor-mm", SCANNER.source_to_cor_mm)
    answer = run("calibrate", *given, "--phantom", "l-shape", "--json").stdout
    (tmp_path / "answer.json").write_text(answer)
    assert json.loads(answer)["scanner"]["detector_arc_radius_mm"] == 1500
    answered, views = tmp_path / "answer.json", tmp_path / "views.json"
    run("export", "--to", "vectors", "--calibration", answered, *("--views", 60, "--angles-deg", "3:6"), "-o", views)
    known = (tmp_path / "scan.h5", *scan, "--geometry", views)
    run("reconstruct", *known, "--size", 32, "--method", "fbp", "-o", tmp_path / "volume.h5")
    found = json.loads(run("drift", *known, "--json").stdout)
    assert found["reference"] == "given-geometry"
    assert abs(found["change"]["cor_column_mm"]) < 0.2


def test_line_integrals_on_an_arc_are_resampled_for_programs_with_straight_detectors(run, result_file, tmp_path):
    known = json.loads(result_file.read_text())
    arc = replace(SCANNER, detector_arc_radius_mm=1500.0)
    (tmp_path / "arc.json").write_text(
        json.dumps({**known, "scanner": {**known["scanner"], "detector_arc_radius_mm": 1500.0}})
    )
    angles = np.deg2rad(15 + 30 * np.arange(12))
    straight = FanBeamGeometry(SCANNER, Theta(**known["theta"]), angles)
    seen, expected = (project(L_SHAPE, DetectorCells.of(scanner), straight.frame, angles) for scanner in (arc, SCANNER))
    np.save(tmp_path / "lines.npy", seen)
    flags = ("--views", 12, "--angles-deg", "15:30", "--flat", tmp_path / "lines.npy", "-o", tmp_path / "out.txt")
    run("export", "--to", "astra", "--calibration", tmp_path / "arc.json", *flags)
    np.testing.assert_allclose(np.loadtxt(tmp_path / "out.txt"), straight.astra_vectors(), rtol=1e-10)
    left = np.linalg.norm(np.load(tmp_path / "out.txt.flat.npy") - expected)
    assert left < 0.3 * np.linalg.norm(seen - expected), "edges are as sharp as a cell"
    np.save(tmp_path / "narrow.npy", seen[:, 1:])
    for wrong in ("narrow.npy", "arc.json"):
        flags = (*flags, "--flat", tmp_path / wrong)
        refused = run("export", "--to", "astra", "--calibration", tmp_path / "arc.json", *flags, code=1)
        assert "must have 256 cells" in refused.stderr


def test_export_turns_the_other_way_with_the_scanner(run, result_file, tmp_path):
    known = json.loads(result_file.read_text())
    (tmp_path / "reversed.json").write_text(json.dumps({**known, "rotation": "reversed"}))
    for name, path, angles in (("a", tmp_path / "reversed.json", "-10:-20"), ("b", result_file, "10:20")):
        flags = ("--to", "astra", "--views", 3, "--angles-deg", angles, "-o", tmp_path / f"{name}.txt")
        run("export", "--calibration", path, *flags)
    assert np.allclose(np.loadtxt(tmp_path / "a.txt"), np.loadtxt(tmp_path / "b.txt"))


@pytest.mark.parametrize(("target", "arguments"), [("odl", odl_arguments), ("cil", cil_arguments)], ids=["odl", "cil"])
def test_export_writes_every_argument_as_json(run, result_file, tmp_path, target, arguments):
    flags = ("--views", 12, "--angles-deg", "15:30", "-o", tmp_path / "out.json")
    run("export", "--to", target, "--calibration", result_file, *flags)
    fan = calibrated(result_file, 15 + 30 * np.arange(12))
    assert json.loads((tmp_path / "out.json").read_text()) == arguments(fan)


def test_export_writes_the_geometry_file_of_rtk(run, result_file, tmp_path):
    flags = ("--views", 3, "--angles-deg", "10:120", "-o", tmp_path / "out.xml")
    run("export", "--to", "rtk", "--calibration", result_file, *flags)
    root = ET.parse(tmp_path / "out.xml").getroot()  # noqa: S314 - our own text
    expected = rtk_arguments(calibrated(result_file, np.array([10.0, 130.0, 250.0])))
    matrices = [np.array(view.findtext("Matrix").split(), float) for view in root.findall("Projection")]
    assert np.array_equal(np.reshape(matrices, (3, 3, 4)), expected["Matrix"])
    assert float(root.findtext("SourceToDetectorDistance")) == expected["SourceToDetectorDistance"]
    assert "256 cells, spacing 4.508593749 mm, origin -574.8457" in (tmp_path / "out.xml").read_text()


def test_export_needs_angles_and_a_known_target(wrong_use, result_file, tmp_path):
    flags = ("--calibration", result_file, "-o", tmp_path / "out.txt", "--views", 12)
    missing = wrong_use("export", "--to", "astra", *flags)
    assert "Missing option '--angles-deg' or '--angles-file' (the views' angles)" in missing
    assert "'matlab'" in wrong_use("export", "--to", "matlab", *flags, "--angles-deg", "0:1")


def test_a_plan_compares_phantoms_at_numbers_of_views(run):
    flags = ("--views", 20, "--views", 90, "--noise", 0.01, "--json")
    answer = json.loads(run("phantom", "plan", "l-shape", "rectangle-with-hole", *THETA, *flags).stdout)
    assert answer["state"] == "succeeded"
    plans = [PlanResult.model_validate(each) for each in answer["plans"]]
    asked = [(phantom, views) for phantom in ("L-shape", "Rectangle with hole") for views in (20, 90)]
    assert [(each.phantom, each.views) for each in plans] == asked
    rays = [each.predicted_ray_error_mm.rms for each in plans]
    assert rays[1] < rays[0] < rays[2]
    assert all(each.noise == 0.01 and each.views_cut_off == 0 for each in plans)


def test_theta_s_angles_may_be_given_in_degrees(run):
    flags = ("--views", 20, "--json")
    in_degrees = json.loads(run("phantom", "plan", "l-shape", "--theta", "45deg,700,0,0,-45deg", *flags).stdout)
    in_radians = json.loads(run("phantom", "plan", "l-shape", "--theta", f"{math.pi / 4},700,0,0,-1", *flags).stdout)
    assert in_degrees["plans"][0]["theta"] == pytest.approx(in_radians["plans"][0]["theta"])


def test_a_plan_is_a_table_for_people_and_reports_a_shadow_beyond_the_detector(run):
    reported = run("phantom", "plan", "l-shape", *THETA, "--detector-pixels", 256, "--views", 20)
    assert "L-shape" in reported.stdout
    assert "rays mm" in " ".join(reported.stdout.split())
    assert "of 20 views reach an end of the detector" in reported.stderr


@pytest.mark.parametrize(
    ("flags", "complaint"),
    [
        (("cube", *THETA), "'PHANTOM...': must be l-shape"),
        (("l-shape", "--theta", "10 deg,2deg,3,4,5"), "'--theta': must be five numbers"),
        (("l-shape", "--theta", "10deg,700,0,0,90deg"), "detector_tilt"),
        (("l-shape", *THETA, "--noise", 0), "'--noise': must be above 0 and at most 1, not 0.0"),
        (("l-shape", *THETA, "--views", 2), "--views"),
    ],
)
def test_wrong_use_of_a_plan_is_refused(wrong_use, flags, complaint):
    assert complaint in wrong_use("phantom", "plan", *flags)


def test_a_drawing_is_svg_in_mm(run, tmp_path):
    run("phantom", "draw", "rectangle-with-hole", "-o", tmp_path / "drawing.svg")
    root = ET.parse(tmp_path / "drawing.svg").getroot()  # noqa: S314 - our own text
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert root.get("width").endswith("mm")
    assert "Rectangle with hole" in [element.text for element in root.iter()]


SID, SDD, SOURCE, PROJECTION = 900.0, 1600.0, 75.0, 150.0
GANTRY_DEG = np.array([12.5, 181.0, 359.0])


def matrix(gantry_deg: float) -> np.ndarray:
    """A point (x, y, z) to the detector, after RTK's documentation of its geometry."""
    c, s = np.cos(np.deg2rad(gantry_deg)), np.sin(np.deg2rad(gantry_deg))
    shift = np.array([[1, 0, SOURCE - PROJECTION], [0, 1, 0], [0, 0, 1]])
    magnify = np.array([[-SDD, 0, 0, 0], [0, -SDD, 0, 0], [0, 0, 1, -SID]])
    return shift @ magnify @ np.array([[c, 0, -s, -SOURCE], [0, 1, 0, 0], [s, 0, c, 0], [0, 0, 0, 1]])


NAMED = {
    "SourceToIsocenterDistance": SID,
    "SourceToDetectorDistance": SDD,
    "SourceOffsetX": SOURCE,
    "ProjectionOffsetX": PROJECTION,
}


def test_the_file_holds_every_number_to_the_last_digit():
    matrices = np.stack([matrix(angle) for angle in GANTRY_DEG])
    text = rtk_xml({**NAMED, "GantryAngle": GANTRY_DEG, "Matrix": matrices}, "three views")
    assert text.startswith('<?xml version="1.0"?>\n<!DOCTYPE RTKGEOMETRY>\n')
    root = ET.fromstring(text)  # noqa: S314 - our own text
    assert (root.tag, root.get("version")) == ("RTKThreeDCircularGeometry", "3")
    assert {name: float(root.findtext(name)) for name in NAMED} == NAMED
    views = root.findall("Projection")
    assert [float(view.findtext("GantryAngle")) for view in views] == GANTRY_DEG.tolist()
    for view, angle in zip(views, GANTRY_DEG, strict=True):
        assert np.array_equal(np.array(view.findtext("Matrix").split(), float).reshape(3, 4), matrix(angle))
