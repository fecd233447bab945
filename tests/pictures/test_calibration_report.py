from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from worker.pictures.calibration_report import calibration_report_png, log_comparison_png, overlay_png

FIELD_MM = 400.0


@pytest.fixture
def report():
    rng = np.random.default_rng(20261120)
    return {
        "image": rng.random((64, 64)),
        "field_mm": FIELD_MM,
        "outlines": [np.array([(-100.0, 51.5), (100.0, 150.0), (100.0, -150.0)])],
        "sinogram": rng.random((20, 48)) + 5,
        "residual": rng.normal(size=(20, 48)) / 10,
        "angles_deg": np.arange(20) * 18 + 0.5,
        "pitch_mm": 1.5,
        "table": [("source shift, mm", "319.94 ± 0.30")],
        "verdict": "pass",
        "title": "Line 2",
    }


def pixels(png):
    return np.asarray(Image.open(BytesIO(png)).convert("RGB")).astype(int)


def near(page, color):
    return (np.abs(page - np.array(color)).max(axis=2) < 40).sum()


GREEN, RED, ORANGE = (0x2E, 0x7D, 0x32), (0xB7, 0x1C, 0x1C), (0xFF, 0x7F, 0x0E)


def test_report_is_a_page(report):
    page = pixels(calibration_report_png(**report))
    assert page.shape == (1120, 1400, 3)


@pytest.mark.parametrize(("verdict", "color", "other"), [("pass", GREEN, RED), ("fail", RED, GREEN)])
def test_badge_has_the_verdicts_color(report, verdict, color, other):
    corner = pixels(calibration_report_png(**(report | {"verdict": verdict})))[:60, -200:]
    assert near(corner, color) > 500
    assert near(corner, other) == 0


def test_same_input_same_bytes(report):
    assert calibration_report_png(**report) == calibration_report_png(**report)


@pytest.mark.parametrize(
    "change", [{"residual": np.zeros((20, 48))}, {"angles_deg": np.array([0, 7, 3.0] * 6 + [1, 2])}]
)
def test_perfect_fit_and_unsorted_angles_have_a_report(report, change):
    assert pixels(calibration_report_png(**(report | change))).size


def test_parts_that_disagree(report):
    with pytest.raises(ValueError, match=r"residual \(20, 48\), the sinogram \(20, 48\) and 19 angles do not agree"):
        calibration_report_png(**(report | {"angles_deg": np.arange(19)}))


def test_outline_lies_where_x_is_down_and_y_is_right():
    black = np.zeros((64, 64))
    outline = np.array([(-190.0, 100.0), (-190.0, 190.0), (-150.0, 190.0), (-150.0, 100.0)])
    page = pixels(overlay_png(image=black, field_mm=FIELD_MM, outlines=[outline], title=""))
    panel = np.argwhere(page.max(axis=2) < 60)
    top, left = panel.min(axis=0)
    bottom, right = panel.max(axis=0)
    row, column = np.argwhere(np.abs(page - np.array(ORANGE)).max(axis=2) < 40).mean(axis=0)
    assert (row - top) / (bottom - top) < 0.35
    assert (column - left) / (right - left) > 0.5


def test_overlay_without_outlines():
    assert near(pixels(overlay_png(image=np.eye(16), field_mm=FIELD_MM, outlines=[], title="x")), ORANGE) == 0


def test_comparison_uses_one_window():
    before, after = np.full((32, 32), 0.5), np.linspace(0, 1, 1024).reshape(32, 32)
    page = pixels(log_comparison_png(before=before, after=after, field_mm=FIELD_MM, titles=("nominal", "calibrated")))
    assert abs(page[page.shape[0] // 2, page.shape[1] // 4, 0] - 128) < 10
