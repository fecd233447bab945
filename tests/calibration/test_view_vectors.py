"""Vectors for each view, in and out: files, images and drift checks by them, and what is refused."""

import json
from dataclasses import fields, replace

import astra
import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from tests.support.exact_chords import full_turn

import sawmill_calibration as sawmill
from sawmill_calibration.known_geometry import from_phantom, to_phantom
from sawmill_calibration.view_vectors import vectors_of
from sawmill_contracts import geometry
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS, PhantomDrawing
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FanViews, to_vector, turning
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms import built_in
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_vocabulary import Disc, ObjectTurns, Polygon, Scanner, SourceFrame, Theta, ThetaBounds

MILL = Scanner(source_to_cor_mm=859.46, num_detector_pixels=288, detector_pitch_mm=4.0)
ON_ARC = Scanner(859.46, 288, 4.0, detector_arc_radius_mm=1500.0)
THETA = Theta(0.7, 715.0, 40.0, 10.0, 0.05)
LOG = LogModel.random(3, radius_mm=105.0).slice_at(60.0).moved(4.0, -3.0)
ANGLES = full_turn(40)
SMALL = {"size": 64, "field_mm": 240.0}
FAN = FanBeamGeometry(MILL, THETA, ANGLES)


def seen_by(views):
    """A scan of the log by these views, with angles that are of no use."""
    lines = [simulate_sinogram(LOG, turning(views.at(slice(one, one + 1))), seed=one)[0] for one in range(len(ANGLES))]
    return sawmill.Scan.from_arrays(np.array(lines), np.zeros(len(lines)), MILL)


@pytest.fixture(scope="module")
def moved():
    """Views, each of its own passage: the log stands elsewhere in each by up to 6 mm."""
    shifts = np.random.default_rng(2).uniform(-6.0, 6.0, (len(ANGLES), 2))
    return FanViews.of(FAN.source_mm + shifts, FAN.middle_mm + shifts, FAN.axis, FAN.borders_mm)


@pytest.fixture(scope="module")
def still():
    return seen_by(FAN)


@pytest.mark.parametrize("scanner", [MILL, ON_ARC])
def test_a_file_of_vectors_is_read_as_it_was_written(tmp_path, scanner):
    fan = FanBeamGeometry(scanner, THETA, ANGLES)
    (tmp_path / "views.json").write_text(json.dumps(vectors_of(fan)))
    np.save(tmp_path / "rows.npy", FAN.astra_vectors())
    for name, written in (("views.json", fan), ("rows.npy", FAN)):
        read = sawmill.read_views(tmp_path / name, 288)
        for ours, theirs in zip(vectors_of(read).values(), vectors_of(written).values(), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-9)
    read = sawmill.read_views(tmp_path / "views.json")
    # Recognised as a turn, all borders of cells are where they were.
    turn = turning(read)
    for view in (0, 17):
        ends = [each.middle_mm[view] + each.borders_mm[..., None] * each.axis[view] for each in (turn, fan)]
        np.testing.assert_allclose(*ends, atol=1e-6)
    np.testing.assert_allclose(turn.source_mm, fan.source_mm, atol=1e-6)


@pytest.mark.parametrize("method", ["fbp", "total_variation"])
def test_vectors_of_a_turn_give_its_image(still, method):
    listed = FanViews.from_astra(FAN.astra_vectors(), 288)
    right = sawmill.Scan.from_arrays(still.line_integrals, ANGLES, MILL)
    image, expected = (
        sawmill.reconstruct(scan, known, method=method, **SMALL).image
        for scan, known in ((still, listed), (right, THETA))
    )
    assert np.abs(image - expected).max() < 1e-5 * expected.max()


@pytest.mark.parametrize(("method", "share"), [("tikhonov", 0.08), ("total_variation", 0.06)])
def test_views_of_their_own_give_the_image_of_a_turn(still, moved, method, share):
    scan = seen_by(moved)
    image, blind, expected = (
        sawmill.reconstruct(one, known, method=method, **SMALL).image
        for one, known in ((scan, moved), (scan, FAN), (still, FAN))
    )
    assert np.linalg.norm(image - expected) < share * np.linalg.norm(expected)
    assert np.linalg.norm(blind - expected) > 3.0 * np.linalg.norm(image - expected)


def test_views_of_their_own_are_for_methods_that_take_them(moved):
    scan = seen_by(moved)
    for use in (lambda: sawmill.reconstruct(scan, moved, method="fbp", **SMALL), lambda: sawmill.drift(scan, moved)):
        with pytest.raises(ValueError, match=r"needs views that turn about one axis, .* by total_variation"):
            use()
    result = sawmill.reconstruct(scan, moved, **SMALL).result
    assert result.theta is None
    assert "no full turn" in result.method.reason


def test_a_drift_check_by_vectors_on_an_arc_gives_the_change_without_a_verdict():
    fan = FanBeamGeometry(ON_ARC, THETA, ANGLES)
    with pytest.raises(ValueError, match=r"mm from equal distances .* only the form vectors holds modules and arcs"):
        fan.astra_vectors()
    scan = sawmill.Scan.from_arrays(simulate_sinogram(LOG, fan, noise=0.002, seed=1), ANGLES, MILL)
    found = sawmill.drift(scan, FanViews.of(fan.source_mm, fan.middle_mm + fan.axis, fan.axis, fan.borders_mm))
    assert found.within_tolerance is None
    assert found.result.detector_change.cor_column_mm == pytest.approx(1.0, abs=0.1)


def test_a_calibration_gives_its_vectors_to_other_programs():
    """The same ray sums in ASTRA; ODL and CIL are in tests/tomography/test_export.py."""
    scan = sawmill.simulate_phantom_scan("l-shape", MILL, THETA, views=40, noise=0.01)
    found = sawmill.calibrate(scan, "l-shape")
    given = found.to_astra(scan.angles_rad)
    volume = astra.create_vol_geom(64, 64, -120.0, 120.0, -120.0, 120.0)
    projector = astra.create_projector("line_fanflat", given, volume)
    image = np.random.default_rng(4).random((64, 64)).astype(np.float32)
    theirs = astra.OpTomo(projector).FP(image)
    astra.projector.delete(projector)
    ours = Projector(found.vectors(scan.angles_rad), ImageGrid(64, 240.0)).forward(image)
    assert np.linalg.norm(ours - theirs) < 1e-4 * np.linalg.norm(theirs)
    assert found.to_odl(scan.angles_rad)["num_detector_pixels"] == 288
    assert len(found.to_cil(scan.angles_rad)["set_angles"]["angles"]) == 40


def test_a_random_list_of_views_gives_the_image_of_astras_sirt(tmp_path):
    rng = np.random.default_rng(9)
    views = []
    for angle in rng.uniform(0.0, 6.283, 60):
        r_s, r_d, *shifts = rng.uniform([700, 600, -60, -60], [1000, 900, 60, 60])
        views.append(FanBeamGeometry(replace(MILL, source_to_cor_mm=r_s), Theta(0, r_d, *shifts, 0.1), [angle]))
    np.save(tmp_path / "rows.npy", np.concatenate([each.astra_vectors() for each in views]))
    lines = np.concatenate([simulate_sinogram(LOG, each, noise=0.01, seed=n) for n, each in enumerate(views)])
    listed = sawmill.read_views(tmp_path / "rows.npy", 288)
    ours = sawmill.reconstruct(sawmill.Scan.from_arrays(lines, np.zeros(60), MILL), listed, **SMALL).image
    volume = astra.create_vol_geom(64, 64, -120.0, 120.0, -120.0, 120.0)
    rays = astra.create_proj_geom("fanflat_vec", 288, listed.astra_vectors())
    data = {"ProjectionDataId": astra.data2d.create("-sino", rays, lines)}
    data["ReconstructionDataId"] = astra.data2d.create("-vol", volume, 0.0)
    known = astra.astra_dict("SIRT") | data | {"ProjectorId": astra.create_projector("line_fanflat", rays, volume)}
    astra.algorithm.run(astra.algorithm.create(known), 40)
    theirs, truth = astra.data2d.get(data["ReconstructionDataId"]), LOG.rasterise(64, 240.0)
    astra.clear()
    of_ours, of_theirs = (np.linalg.norm(image - truth) / np.linalg.norm(truth) for image in (ours, theirs))
    assert of_ours < of_theirs < 0.12


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        (np.zeros((3, 5)), r"must be \(views, 6\) numbers, not \(3, 5\)"),
        (np.array([[0.0, -9, 0, 5, 1, 0], [0.0, -9, 0, 5, 2, 0]]), "the same width in all views"),
        (np.array([[0.0, -9, 0, -12, 1, 0]]), "in view 0, from 0, the centre of rotation is not on"),
        (np.full((2, 6), np.nan), "must be numbers of mm"),
    ],
)
def test_rows_that_are_no_geometry_are_refused(tmp_path, rows, why):
    np.save(tmp_path / "rows.npy", rows)
    with pytest.raises(sawmill.InputError, match=f"rows.npy is no file of geometry, .*: .*{why}"):
        sawmill.read_views(tmp_path / "rows.npy", 8)


def test_a_geometry_of_another_scan_is_refused(still):
    with pytest.raises(sawmill.InputError, match=r"\(views, cells\) = \(39, 288\), and the scan has \(40, 288\)"):
        sawmill.reconstruct(still, FAN.at(slice(1, None)), **SMALL)


def crossed(kind, value):
    adapter = TypeAdapter(kind)
    return adapter.validate_json(adapter.dump_json(adapter.validate_python(value)))


def test_the_constants_cross_as_they_are_and_theta_makes_the_loop(constants, scanner, theta):
    assert crossed(Scanner, scanner) == scanner
    assert crossed(geometry.ScannerConstants, constants) == constants
    assert {name: getattr(constants, name) for name in vars(scanner)} == vars(scanner)
    assert crossed(Theta, theta) == theta
    assert list(json.loads(TypeAdapter(Theta).dump_json(theta)).values()) == list(to_vector(theta))


def test_the_source_frame_with_its_magnification_and_bounds_make_the_loop(theta):
    frame = theta.source_frame(859.46)
    back = crossed(geometry.ReportedSourceFrame, frame)
    assert vars(back) == vars(frame)
    assert back.magnification == pytest.approx(frame.source_to_detector_mm / frame.source_distance_mm)
    answered = json.loads(TypeAdapter(geometry.ReportedSourceFrame).dump_json(back))
    assert answered == {**vars(frame), "magnification": frame.magnification}
    found = crossed(ThetaBounds, ThetaBounds(source_shift_mm=(-10.0, 20.0)))
    assert isinstance(found, ThetaBounds)
    assert found.source_shift_mm == (-10.0, 20.0)


def test_what_is_given_is_held_against_what_a_scanner_can_be_but_not_what_is_stored(theta):
    beyond = Theta(*to_vector(theta)[:4], 11.0)
    assert TypeAdapter(Theta).validate_python(beyond) == beyond
    with pytest.raises(ValidationError, match="less than or equal to 10"):
        TypeAdapter(geometry.GivenTheta).validate_python(vars(beyond))
    wide = ThetaBounds(detector_tilt=(-11.0, 1.0))
    assert TypeAdapter(ThetaBounds).validate_python(wide) == wide
    with pytest.raises(ValidationError, match="greater than or equal to -10"):
        TypeAdapter(geometry.GivenThetaBounds).validate_python(vars(wide))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_no_value_crosses_with_a_number_that_is_not_finite(theta, value):
    with pytest.raises(ValidationError, match="finite"):
        TypeAdapter(Theta).validate_python(Theta(value, *to_vector(theta)[1:]))


def test_standard_deviations_have_the_names_of_what_they_are_of():
    assert list(geometry.ThetaDeviation.model_fields) == [one.name for one in fields(Theta)]
    of_frame = [one.name for one in fields(SourceFrame)]
    assert list(geometry.SourceFrameDeviation.model_fields) == [*of_frame, "magnification"]


@pytest.mark.parametrize("name", BUILT_IN_PHANTOMS)
def test_a_drawing_makes_the_loop(name):
    drawing = BUILT_IN_PHANTOMS[name]
    assert from_phantom(to_phantom(drawing)) == drawing
    assert PhantomDrawing.model_validate_json(drawing.model_dump_json()) == drawing


def test_density_and_tolerance_make_the_loop():
    corner = Polygon(vertices_mm=((0, 0), (10, 0), (0, 10)), density=2.0)
    hole = Disc(center_mm=(3, 3), radius_mm=1, density=-2.0)
    drawing = PhantomDrawing(name="ours", size_tolerance=0.004, shapes=[corner, hole])
    assert from_phantom(to_phantom(drawing)) == drawing


def test_contracts_and_science_draw_the_same_built_in_phantoms():
    assert set(BUILT_IN_PHANTOMS) == set(built_in.BUILT_IN)
    for name, drawing in BUILT_IN_PHANTOMS.items():
        phantom = to_phantom(drawing)
        assert phantom.shapes == built_in.BUILT_IN[name].shapes
        assert phantom.size_tolerance == built_in.BUILT_IN[name].size_tolerance
        np.testing.assert_array_equal(phantom.edges, built_in.BUILT_IN[name].edges)


def test_a_scanner_that_turns_the_log_between_passages_finds_where_it_stands(moved):
    declared = replace(MILL, object_turns=ObjectTurns.BETWEEN_PASSAGES)
    scan = sawmill.Scan.from_arrays(seen_by(moved).line_integrals, ANGLES, declared)
    settings = {"method": "total_variation", "weight": 300.0, "coupling": "none", **SMALL}
    found, blind = (sawmill.reconstruct(scan, THETA, **settings, view_poses=how) for how in ("auto", "none"))
    remark = next(each for each in found.result.method.coded_remarks if each.code == "views-stand-elsewhere")
    assert remark.values["shift_mm"] == pytest.approx(6.0 / 3.0**0.5, rel=0.15)
    assert found.result.method.data_misfit < 0.3 * blind.result.method.data_misfit
    with pytest.raises(ValueError, match="reconstruct them by total_variation"):
        sawmill.reconstruct(scan, THETA, method="fbp", **SMALL)
    cut = sawmill.Scan.from_arrays(scan.line_integrals[..., 120:168], ANGLES, replace(declared, num_detector_pixels=48))
    assert "air on both sides" in " ".join(sawmill.reconstruct(cut, THETA, **settings).result.method.remarks)
