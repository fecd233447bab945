"""The measured discs: the converter of the published files, what is read of them, and the tables of the page."""

import json
import math

import measured
import measured_discs as discs
import numpy as np
import pytest
from edge_error import edge_error_mm
from opposite_ray_fit import opposite_ray_fit
from PIL import Image
from scipy.io import savemat

import sawmill_calibration as sawmill

PHANTOM = sawmill.Phantom("disc with a hole", (sawmill.Disc((1.0, -2.0), 30.0), sawmill.Disc((9.0, 6.0), 8.0, -1.0)))
COR_MM, TILT_DEG = -0.05, 0.18
KNOWN = {"cor_column_mm": COR_MM, "cor_column_sd_mm": 0.001, "tilt_deg": TILT_DEG, "tilt_sd_deg": 0.02}


def turn(scanner, views):
    theta = discs.nominal_frame(COR_MM, math.radians(TILT_DEG)).theta(scanner.source_to_cor_mm)
    return sawmill.simulate_phantom_scan(PHANTOM, scanner, theta, views=views, noise=0.002).line_integrals[:, 0]


def published(folder, sinogram, **changes):
    """A file as it is published: the last view is the first one again."""
    parameters = {
        "distanceSourceOrigin": discs.SCANNER.source_to_cor_mm,
        "distanceSourceDetector": discs.SOURCE_TO_DETECTOR_MM,
        "pixelSizePost": discs.SCANNER.detector_pitch_mm,
        "angles": np.arange(discs.VIEWS + 1) * 0.5,
    }
    struct = {"type": "2D", "sinogram": np.vstack([sinogram, sinogram[:1]]), "parameters": parameters | changes}
    path = folder / "htc2022_xa_full.mat"
    savemat(path, {"CtDataFull": struct})
    return path


def test_the_independent_fit_finds_cor_and_tilt():
    """Splines over the disc's sharp edges, between coarse cells, leave 0.002 mm and 0.03 degrees."""
    coarse = sawmill.Scanner(discs.SCANNER.source_to_cor_mm, 70, 1.6)
    found = opposite_ray_fit(
        turn(coarse, 240).astype(np.float64), pitch_mm=1.6, source_to_detector_mm=discs.SOURCE_TO_DETECTOR_MM
    )
    assert found.cor_column_mm == pytest.approx(COR_MM, abs=0.005)
    assert found.tilt_deg == pytest.approx(TILT_DEG, abs=0.06)


@pytest.mark.nightly
def test_published_files_are_converted_to_discs(tmp_path):
    (tmp_path / "published").mkdir()
    sinogram = turn(discs.SCANNER, discs.VIEWS)
    published(tmp_path / "published", sinogram)
    Image.new("1", (512, 512)).save(tmp_path / "published/htc2022_xa_recon_fbp_seg.png")
    discs.convert(tmp_path / "published", tmp_path / "discs")
    (disc,) = discs.read_discs(tmp_path / "discs")
    assert (disc.name, disc.outline.is_file()) == ("xa", True)
    assert np.array_equal(disc.sinogram, sinogram)
    known = disc.independent
    assert known.cor_column_mm == pytest.approx(COR_MM, abs=max(3.0 * known.cor_column_sd_mm, 0.001))
    assert known.tilt_deg == pytest.approx(TILT_DEG, abs=max(3.0 * known.tilt_sd_deg, 0.01))


def test_files_that_are_not_the_published_ones_are_refused(tmp_path):
    with pytest.raises(SystemExit, match=r"no htc2022_\*_full.mat in .* doi 10.5281/zenodo.7418878"):
        discs.convert(tmp_path, tmp_path / "discs")
    path = published(tmp_path, np.zeros((discs.VIEWS, 560), np.float32), distanceSourceOrigin=400.0)
    with pytest.raises(SystemExit, match=r"htc2022_xa_full.mat has .*400.*where .*410\.66"):
        discs.published_sinogram(path)
    savemat(path, {"CtDataLimited": {"type": "2D"}})
    with pytest.raises(SystemExit, match=r"htc2022_xa_full\.mat has no 'CtDataFull': it is none of the files of doi"):
        discs.published_sinogram(path)


def test_where_the_discs_are_absent_a_sentence_says_how_to_get_them(tmp_path, monkeypatch):
    monkeypatch.setenv("SAWMILL_PUBLISHED_DATA", str(tmp_path))
    with pytest.raises(SystemExit, match=r"no measured discs in .*10\.5281/zenodo\.7418878.*SAWMILL_PUBLISHED_DATA"):
        discs.discs_folder()


def test_several_discs_of_few_views_are_read_from_one_file(tmp_path):
    sinograms = np.arange(2 * 90 * 560, dtype=np.float32).reshape(2, 90, 560)
    np.savez(tmp_path / discs.FEW_VIEWS, sinograms=sinograms, names=np.array(["a", "b"]))
    (tmp_path / "independent.json").write_text(json.dumps({"b": KNOWN | {"date": "20220616"}, "a": KNOWN}))
    second, first = discs.read_discs(tmp_path)
    assert (second.name, first.name, first.views) == ("b", "a", 90)
    part = first.scan(18, start=3)
    assert np.allclose(np.degrees(part.angles_rad), np.arange(18) * 20.0 + 12.0)
    assert np.array_equal(part.line_integrals[:, 0], sinograms[0, 3::5])
    assert (measured.starts(first, 18), measured.starts(first, 90)) == ([0, 1, 3], [0])


def test_a_refused_calibration_stands_in_the_table_and_a_wrong_pass_is_counted():
    numbers = {"cor_off_mm": 0.01, "cor_sd_mm": 0.02, "tilt_off_deg": 0.1, "tilt_sd_deg": 0.2}
    numbers |= {"bound_mm": 0.02, "scale_off_percent": 0.05, "scale_bound_percent": 0.3}
    results = [
        made
        for views in measured.CALIBRATED_VIEWS
        for made in (
            measured.Calibrated("a", views, "pass", ray_error_mm=0.004, **numbers),
            measured.Calibrated("b", views, "pass", ray_error_mm=0.12, **numbers),
            measured.Calibrated("c", views, "phantom-not-seen"),
        )
    ]
    table = measured.calibration_table(results)
    assert table.splitlines()[2] == "| a " + "| `pass` | 0.0040, 0.020 | 0.05, 0.30 % " * 2 + "|"
    assert table.splitlines()[4] == "| c " + "| refused, `phantom-not-seen` |  |  " * 2 + "|"
    figures = measured.calibration_figures(results[:3])
    assert (figures["calibrated"], figures["`pass`, and of these wrong"]) == ("2 of 3", "2, 1")
    assert figures["rays within their bound"] == "1 of 2"


def test_refused_drift_checks_and_intervals_are_counted_and_images_averaged_over_discs():
    checks = ("a", 20, 0.03, 0.02, 0.001), ("a", 20, 0.05, 0.02, 0.001), ("b", 20)
    results = [measured.Checked(*each) for each in checks]
    row = next(line for line in measured.drift_table(results).splitlines() if line.startswith("| 20 "))
    assert row == "| 20 | 3 | 2 | 0.0412 mm | 0.0200 mm | 1 of 2 |"
    drawn = ("a", 20, "fbp", 0.4, 0.8), ("b", 20, "fbp", 0.5, 0.9), ("a", discs.VIEWS, "fbp", 0.0, 0.99)
    lines = measured.image_table([measured.Drawn(*each) for each in drawn]).splitlines()
    assert lines[2].startswith("| 20 | 0.450, 0.850 |  |")
    assert lines[-1].startswith("| 720 | 0, 0.990 |")


def body(size=128, *, shift=0.0, knot=1.0):
    """A disc with a denser knot; the knot moved along x by `shift` pixels."""
    x = np.arange(size) - 0.5 * (size - 1)
    fine = np.zeros((size, size))
    for dx in (-0.375, -0.125, 0.125, 0.375):
        for dy in (-0.375, -0.125, 0.125, 0.375):
            px, py = (x + dx)[:, None], (x + dy)[None, :]
            fine += np.hypot(px, py) < 50.0
            fine += knot * (np.hypot(px - 10.0 - shift, py) < 15.0)
    return fine / 16.0


def test_outlines_in_place_have_no_edge_error():
    # The outline is read between pixels, at steps of an eighth.
    assert edge_error_mm(body(), body(), 2.0) < 2.0 * 0.15


def test_a_knot_out_of_place_is_measured_in_mm():
    """Moved by s, a circle's outline is displaced by s cos(angle) along its normal: s / sqrt(2) in the mean square."""
    error = edge_error_mm(body(shift=3.0), body(), 2.0)
    assert error == pytest.approx(2.0 * 3.0 / np.sqrt(2.0) * np.sqrt(15.0 / (15.0 + 50.0)), rel=0.2)
    assert edge_error_mm(body(shift=1.0), body(), 2.0) < error


def test_a_missing_knot_counts_as_out_of_reach_and_an_even_truth_has_no_outline():
    outline = 15.0 / (15.0 + 50.0)
    assert edge_error_mm(body(knot=0.0), body(), 1.5) == pytest.approx(1.5 * 5.0 * np.sqrt(outline), rel=0.15)
    assert edge_error_mm(np.zeros((32, 32)), np.ones((32, 32)), 1.0) == 0.0
