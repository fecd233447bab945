"""`sawmill reconstruct`: its flags, also those that prepare a scan, its answers and its refusals."""

import json
import shutil

import h5py
import numpy as np
import pytest
from PIL import Image

from sawmill_calibration.scans import scan_rows
from sawmill_calibration.scans.scan_rows import ScanSource, open_rows
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.reconstruction.quality import relative_error
from sawmill_vocabulary import DataKind, Progress
from sawmill_worker.commands.options import ScanOptions

THETA = ("--theta", "2.55,714.7,319.9,43.7,0.281", "--source-to-cor-mm", 859.46)
SCANNER = ("--source-to-cor-mm", 859.46, "--detector-pitch-mm", 4.508593749)


def volume(path) -> np.ndarray:
    with h5py.File(path) as file:
        assert file["entry/reconstruction/data"].dtype == np.float32
        return file["entry/reconstruction/data"][()]


@pytest.fixture
def changed(phantom_scan, tmp_path):
    """A copy of the scan, opened to change it."""
    shutil.copy(phantom_scan, tmp_path / "scan.h5")
    return tmp_path / "scan.h5"


LINES = ("--data", "line-integrals", *THETA)
DETECTOR, ANGLES = "entry/instrument/detector", "entry/sample/rotation_angle"


def test_the_calibration_alone_is_enough(run, stack, result_file, tmp_path):
    flags = ("--data", "counts", "--calibration", result_file, "--rows", "2:4", "-o", tmp_path / "out.h5")
    assert run("reconstruct", stack, *flags, "--png", tmp_path / "out.png").stdout == ""
    slices = volume(tmp_path / "out.h5")
    assert slices.shape == (2, 256, 256)
    # Row 2 of the stack, as simulated.
    assert relative_error(slices[0], LogModel.random(1).slice_at(24.0).rasterise(256, 400.0)) < 0.25
    with Image.open(tmp_path / "out.png") as picture:
        assert picture.format == "PNG"


def test_the_product_s_own_scan_is_read_row_by_row(run, phantom_scan, bare_scan, tmp_path, monkeypatch):
    flags = ("--data", "line-integrals", "--rows", "1:2", *THETA, "--method", "fbp")
    more = ("--angles-deg", "3:6", "--detector-pitch-mm", 4.508593749)
    run("reconstruct", bare_scan, *flags, *more, "-o", tmp_path / "whole.h5")
    monkeypatch.delattr(scan_rows, "prepare_scan")
    run("reconstruct", phantom_scan, *flags, "-o", tmp_path / "rows.h5")
    # The pitch that is given has ten digits, the file's all of them.
    assert relative_error(volume(tmp_path / "rows.h5"), volume(tmp_path / "whole.h5")) < 1e-4


def test_a_foreign_scan_is_prepared_beside_the_output_and_nothing_of_it_stays(run, stack, bare_scan, tmp_path):
    seen = []

    def on_progress(progress):
        seen.append((progress.stage, progress.fraction, [path.name for path in tmp_path.glob(".sawmill-*/*")]))

    source = ScanSource(stack, ScanOptions(data=DataKind.COUNTS))
    with open_rows(source, source_to_cor_mm=859.46, on_progress=on_progress, beside=tmp_path / "out.h5") as rows:
        assert rows.stack().shape == (60, 4, 256)
        rows.on_progress(Progress(fraction=0.5, stage="reconstruct"))
    fractions = [fraction for _, fraction, _ in seen]
    assert fractions == sorted(fractions)
    assert [(stage, fraction) for stage, fraction, _ in seen[-2:]] == [("read", 0.5), ("reconstruct", 0.75)]
    assert seen[-1][2] == ["scan.h5"]
    assert list(tmp_path.iterdir()) == []
    flags = ("--data", "line-integrals", "--angles-deg", "3:6", *THETA, "-o", tmp_path / "out.h5")
    run("reconstruct", bare_scan, *flags, code=1)
    assert list(tmp_path.iterdir()) == []


def test_a_value_that_is_no_number_is_reported_when_its_row_is_read(failure, changed, tmp_path):
    with h5py.File(changed, "r+") as file:
        file[f"{DETECTOR}/data"][3, 1, 7] = np.nan
    reported = failure("reconstruct", changed, *LINES, "-o", tmp_path / "out.h5")
    assert (reported["code"], reported["detail"][:6]) == ("not-finite", "row 1 ")
    assert not (tmp_path / "out.h5").exists()


def test_a_log_that_shows_nothing_has_no_curve_of_alpha(failure, changed, tmp_path):
    with h5py.File(changed, "r+") as file:
        file[f"{DETECTOR}/data"][...] = 0.0
    flags = ("-o", tmp_path / "out.h5", "--method", "tikhonov", "--alpha-curve", tmp_path / "curve.png")
    assert failure("reconstruct", changed, *LINES, *flags)["code"] == "no-alpha-curve"
    assert not (tmp_path / "curve.png").exists()
    assert not volume(tmp_path / "out.h5").any()


def _elsewhere(file):
    del file[ANGLES]
    file[ANGLES] = h5py.ExternalLink("other.h5", "/angles")


def _too_few_angles(file):
    del file[ANGLES]
    file[ANGLES] = np.arange(4.0)
    file[ANGLES].attrs["units"] = "deg"


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda file: file.__delitem__(ANGLES), "angles-missing"),
        (lambda file: file.__delitem__(f"{DETECTOR}/x_pixel_size"), "detector-pitch-missing"),
        (lambda file: file[ANGLES].__setitem__(3, np.nan), "not-finite"),
        (_too_few_angles, "angles-mismatch"),
        (_elsewhere, "external-storage"),
    ],
)
def test_a_scan_of_the_product_that_was_tampered_with_is_refused(failure, changed, tmp_path, change, code):
    with h5py.File(changed, "r+") as file:
        change(file)
    assert failure("reconstruct", changed, *LINES, "-o", tmp_path / "out.h5")["code"] == code


def test_a_scan_of_the_product_that_lost_an_axis_is_read_as_any_other(run, changed, tmp_path):
    with h5py.File(changed, "r+") as file:
        stack, named = file[f"{DETECTOR}/data"][:, 0], dict(file[f"{DETECTOR}/data"].attrs)
        del file[f"{DETECTOR}/data"]
        file[f"{DETECTOR}/data"] = stack
        file[f"{DETECTOR}/data"].attrs.update(named)
    run("reconstruct", changed, *LINES, "--method", "fbp", "-o", tmp_path / "out.h5")
    assert volume(tmp_path / "out.h5").shape == (1, 256, 256)


def test_damage_is_reported_when_its_row_is_read(failure, changed, tmp_path):
    whole = bytearray(changed.read_bytes())
    with h5py.File(changed) as file:
        start = file[f"{DETECTOR}/data"].id.get_chunk_info_by_coord((0, 1, 0)).byte_offset
    whole[start + 100 : start + 200] = bytes(100)
    changed.write_bytes(whole)
    assert failure("reconstruct", changed, *LINES, "-o", tmp_path / "out.h5")["code"] == "broken-file"


def test_a_good_fbp_names_no_misfit_and_a_wrong_geometry_is_reported(run, tmp_path):
    """The scan has 90 views: from fewer, FBP with the right geometry misses as much as with a wrong one."""
    scan, cells = tmp_path / "log.h5", ("--detector-pixels", 256, "--views", 90)
    run("simulate", "log", "--theta", THETA[1], *SCANNER, *cells, "--rows", 1, "-o", scan)
    flags = ("--data", "counts", "--source-to-cor-mm", 859.46, "-o", tmp_path / "out.h5")
    good = run("reconstruct", scan, *flags, "--theta", THETA[1], "--method", "fbp", "--json")
    assert json.loads(good.stdout)["method"]["data_misfit"] > 1.0
    assert "the noise" not in good.stderr
    assert "Check the geometry" not in good.stderr
    wrong = run("reconstruct", scan, *flags, "--theta", "2.55,732,334,33,0.251", "--method", "fbp")
    assert "Check the geometry" in wrong.stderr
    fitted = run("reconstruct", scan, *flags, "--theta", THETA[1], "--method", "tikhonov", "--size", 64)
    assert "times the noise" in fitted.stderr


def test_the_sense_of_rotation_comes_with_theta(run, phantom_scan, tmp_path):
    flags = ("--data", "line-integrals", "--rows", "0:1", *THETA, "--method", "fbp")
    run("reconstruct", phantom_scan, *flags, "--rotation", "as-given", "-o", tmp_path / "given.h5")
    run("reconstruct", phantom_scan, *flags, "--rotation", "reversed", "-o", tmp_path / "reversed.h5")
    truth = L_SHAPE.rasterise(256, 400.0)
    assert relative_error(volume(tmp_path / "given.h5")[0], truth) < 0.25
    assert relative_error(volume(tmp_path / "reversed.h5")[0], truth) > 0.5


def test_json_reports_what_the_volume_holds(run, stack, result_file, tmp_path):
    flags = ("--data", "counts", "--calibration", result_file, "--size", 64, "--field-mm", 320, "--filter", "cosine")
    document = json.loads(run("reconstruct", stack, *flags, "-o", tmp_path / "out.h5", "--json", "--views", 30).stdout)
    assert (document["state"], document["shape"], document["pixel_mm"]) == ("succeeded", [4, 64, 64], 5.0)
    assert document["views"] == 30
    with h5py.File(tmp_path / "out.h5") as file:
        assert volume(tmp_path / "out.h5").shape == (4, 64, 64)
        assert file["entry/reconstruction/data"].attrs["units"] == "1/mm"


def test_filters_and_weighting_matter(run, stack, tmp_path):
    def made(*flags):
        given = ("--data", "counts", "--rows", "2:3", "--size", 64, *THETA)
        run("reconstruct", stack, *given, *flags, "-o", tmp_path / "out.h5")
        return volume(tmp_path / "out.h5")

    default = made("--method", "fbp", "--filter", "hann", "--weighting", "exact")
    for flags in (("--filter", "ram-lak"), ("--frequency-scaling", 0.5), ("--weighting", "none")):
        # Who gives an option of fbp has chosen fbp.
        changed = made(*flags)
        assert relative_error(changed, default) > 0.01
        assert np.array_equal(changed, made("--method", "fbp", *flags))


def test_a_region_of_interest_of_every_other_row_is_cut_out_of_the_whole_whose_pictures_are_written(
    run, stack, tmp_path
):
    flags = ("--data", "counts", *THETA, "--method", "fbp", "-o", tmp_path / "out.h5")
    pictures = {name: tmp_path / f"{name}.png" for name in ("mosaic", "side")}
    named = [part for name, path in pictures.items() for part in (f"--{name}", path)]
    run("reconstruct", stack, *flags, "--size", 64, "--field-mm", 320, *named)
    for path in pictures.values():
        with Image.open(path) as picture:
            assert (picture.format, min(picture.size) > 256) == ("PNG", True)
    whole = volume(tmp_path / "out.h5")
    region = ("--size", 16, "--field-mm", 80, "--field-centre-mm", "50,-40", "--rows", "1:4:2")
    document = json.loads(run("reconstruct", stack, *flags, *region, "--json").stdout)
    assert (document["rows"], document["row_step"], document["shape"]) == ([1, 4], 2, [2, 16, 16])
    # Positions on the detector are single precision.
    np.testing.assert_allclose(volume(tmp_path / "out.h5"), whole[1:4:2, 34:50, 16:32], atol=1e-4 * whole.max())
    with h5py.File(tmp_path / "out.h5") as file:
        written = file["entry/reconstruction"]
        assert (written["x"][()].mean(), written["y"][()].mean()) == pytest.approx((50.0, -40.0))
        assert written["z"][()].tolist() == [2.0, 6.0]


def test_what_contradicts_the_calibration_or_the_field_is_refused(failure, stack, result_file, tmp_path):
    np.save(tmp_path / "wide.npy", np.zeros((60, 1, 300), np.float32))
    counts, output = (stack, "--data", "counts"), ("-o", tmp_path / "out.h5")
    wide = (tmp_path / "wide.npy", "--data", "line-integrals", "--angles-deg", "3:6")
    for scan, flags, sentence in (
        (counts, ("--source-to-cor-mm", 860), "859.46"),
        (counts, ("--detector-pitch-mm", 4.5), "4.5"),
        (wide, (), "num_detector_pixels 256 and the scan has 300"),
    ):
        reported = failure("reconstruct", *scan, "--calibration", result_file, *output, *flags)
        assert (reported["code"], sentence in reported["detail"]) == ("contradiction", True)
    assert "field_mm" in failure("reconstruct", *counts, *THETA, "--field-mm", 2000, *output)["detail"]
    assert not (tmp_path / "out.h5").exists()


def test_an_output_that_cannot_be_written_is_reported(failure, stack, tmp_path):
    (tmp_path / "full").mkdir(mode=0o700)
    target = tmp_path / "full" / ("x" * 300 + ".h5")
    assert failure("reconstruct", stack, "--data", "counts", *THETA, "-o", target)["code"] == "file-system"
    assert list((tmp_path / "full").iterdir()) == []


@pytest.mark.parametrize(
    ("flags", "complaint"),
    [
        ((), "or '--geometry' (the geometry)"),
        (("--theta", "1,2,3,4", "--source-to-cor-mm", 859), "'--theta': must be five numbers"),
        (("--theta", "1,2,3,4,inf", "--source-to-cor-mm", 859), "'--theta': must be five numbers"),
        (
            ("--theta", "1,2,3,1e300,0", *THETA[2:]),
            "detector_shift_mm must be at least -100000 and at most 100000, not",
        ),
        (("--theta", "1,-2,3,4,5", *THETA[2:]), "detector_to_cor_mm must be above 0 and at most 100000, not -2"),
        ((*THETA, "--field-centre-mm", "1e300,0"), "x must be at least -100000 and at most 100000, not 1e300"),
        (("--theta", "1,700,3,4,0"), "Missing option '--source-to-cor-mm'"),
        ((*THETA, "--rotation", "left"), "'left' is not one of"),
        ((*THETA, "--method", "guess"), "'guess'"),
        ((*THETA, "--filter", "boxcar"), "'boxcar' is not one of"),
        ((*THETA, "--frequency-scaling", 1.5), "--frequency-scaling"),
        ((*THETA, "--sigma", 0), "'--sigma': must be above 0, not 0"),
        ((*THETA, "--size", 8), "--size"),
        ((*THETA, "--field-mm", -1), "must be above 0 and at most 100000, not -1"),
        ((*THETA, "--rows", "x"), "'--rows': rows must be A:B"),
        ((*THETA, "--png", "no/such/folder/out.png"), "there is no folder"),
        ((*THETA, "--mosaic", "no/such/folder/out.png"), "there is no folder"),
        ((*THETA, "--size", "256,128"), "'256,128' is not one number: pixels are square"),
        ((*THETA, "--field-mm", "400x300"), "'400x300' is not one number: pixels are square"),
        ((*THETA, "--field-centre-mm", "50"), "'--field-centre-mm': must be X,Y, not '50'"),
        ((*THETA, "--field-centre-mm", "50,1e9"), "--field-centre-mm"),
        ((*THETA, "--rows", "0:4:0"), "as in 0:2500:10"),
    ],
)
def test_wrong_use_is_found_before_the_scan_is_read(wrong_use, tmp_path, flags, complaint):
    (tmp_path / "scan.h5").write_text("whoever reads this finds that it is no scan")
    reported = wrong_use("reconstruct", tmp_path / "scan.h5", "--data", "counts", "-o", tmp_path / "out.h5", *flags)
    assert complaint in reported


def test_one_geometry_is_given(wrong_use, stack, result_file, tmp_path):
    flags = ("--data", "counts", "--calibration", result_file, "-o", tmp_path / "out.h5")
    assert "one of them" in wrong_use("reconstruct", stack, *flags, *THETA)
    assert "--rotation comes with --theta" in wrong_use("reconstruct", stack, *flags, "--rotation", "reversed")
    missing = wrong_use("reconstruct", stack, *flags[:-2])
    assert "Missing option '--output' / '-o' OUT (The file that is written)" in missing


COARSE = (*THETA, "--detector-pitch-mm", 9.0)
ROWS, LOST = 40, 5


@pytest.fixture(scope="session")
def lossy(run, scans):
    """Line integrals of a log, 0.2 too high, each view without some rows at the top and the bottom; the losses."""
    whole, path = scans / "log.h5", scans / "lossy.npz"
    body = ("log", "--data", "line-integrals", "--rows", ROWS, "--row-pitch-mm", 3, "--noise", 0.002)
    run("simulate", *body, *COARSE, "--detector-pixels", 128, "--views", 36, "--background", 0.2, "-o", whole)
    with h5py.File(whole) as file:
        views = file["entry/instrument/detector/data"][()]
        angles = file["entry/sample/rotation_angle"][()]
    lost = np.full_like(views, np.nan)
    top, bottom = np.random.default_rng(71).integers(0, LOST, (2, len(views)))
    for view in range(len(views)):
        kept = ROWS - top[view] - bottom[view]
        lost[view, :kept] = views[view, top[view] : top[view] + kept]
    np.savez(path, projections=lost, angles_deg=angles)
    return path, top, bottom


def reconstruct(run, path, output, *flags, code=0):
    given = (*COARSE, "--data", "line-integrals", "--size", 32)
    return json.loads(run("reconstruct", path, *given, "-o", output, "--json", *flags, code=code).stdout)


def test_views_that_lost_rows_are_reconstructed_when_asked(run, lossy, tmp_path):
    path, top, bottom = lossy
    output = tmp_path / "out.h5"
    answer = reconstruct(run, path, output, "--align-rows", "profile", "--air", "background", "--rings", "sorting")
    rows = np.arange(ROWS)[:, None]
    views = ((rows >= top) & (rows < ROWS - bottom)).sum(axis=1)
    first, last = np.flatnonzero(views >= 18)[[0, -1]]
    # All rows that half of the 36 views have, by their own numbers.
    assert (answer["rows"], answer["shape"]) == ([first, last + 1], [last + 1 - first, 32, 32])
    assert answer["fewest_views"] == views[first : last + 1].min() < answer["views"]
    air, rings, aligned = answer["coded_preparation"]
    assert (air["code"], round(air["values"]["level"], 1), rings["code"]) == ("air-level", 0.2, "rings-removed")
    assert aligned["code"].startswith("rows-aligned")
    assert (aligned["values"]["first"], aligned["values"]["last"], aligned["values"]["rows"]) == (first, last + 1, 40)
    with h5py.File(output) as file:
        assert list(file["entry/process/parameters/preparation"].asstr()) == answer["preparation"]


@pytest.mark.parametrize(
    ("flags", "sentence"),
    [
        (("--align-rows", "profile", "--rows", "0:8"), "rows 0:8 were asked for, but too many views lost some of them"),
        ((), "(--align-rows)"),
    ],
    ids=["rows that too few views have", "views of unequal rows as they are"],
)
def test_lost_rows_are_refused_with_their_numbers_or_the_flag(run, lossy, tmp_path, flags, sentence):
    assert sentence in json.dumps(reconstruct(run, lossy[0], tmp_path / "out.h5", *flags, code=1))
