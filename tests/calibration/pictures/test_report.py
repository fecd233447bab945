"""The report as an HTML page and as a picture: what it shows, and that it never claims what is not known."""

import re
from base64 import b64decode
from datetime import datetime, timedelta, timezone
from functools import cache
from html import unescape
from io import BytesIO
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from asgi import text_of
from PIL import Image
from results import FRAME, THETA, calibration_result, comparison

from sawmill_calibration.pictures.calibration_report import overlay_png, report_panels, report_png
from sawmill_calibration.pictures.report_numbers import calibration_table
from sawmill_calibration.pictures.report_page import About, css_text, report_html
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.scanners import Tolerances
from sawmill_vocabulary.calibration_arrays import CalibrationArrays
from sawmill_vocabulary.messages import Reader
from sawmill_vocabulary.uncertainty import BudgetLine

VIEWS, CELLS = 20, 48
EASTERN = timezone(timedelta(hours=2), "EET")
# A variance for each of the source frame's five; R and SDD go together by 0.9.
VARIANCES = np.diag([1e-8, 0.25, 0.64, 1e-4, 1e-6])
VARIANCES[1, 2] = VARIANCES[2, 1] = 0.9 * 0.5 * 0.8


def answer(**changes):
    hypothesis = {"handedness": "as-drawn", "rotation": "as-given", "relative_residual": 0.001}
    own = {
        "theta_twin": THETA | {"source_shift_mm": -319.9, "initial_angle_rad": 3.26},
        "covariance": VARIANCES.tolist(),
        "hypotheses": [hypothesis, hypothesis | {"handedness": "from-behind", "log_likelihood_behind": 345.25}],
        "adjustments": ["2 detector cells <without> a usable signal were left out"],
        "limits": {"tolerance_mm": 0.1, "scale_tolerance_percent": 0.5},
        "rays_verdict": "pass",
    }
    return CalibrationResult.model_validate(calibration_result(**own | changes))


def arrays(**changes):
    rng = np.random.default_rng(20261122)
    seen = np.ones((VIEWS, CELLS))
    rays = {"sinogram": seen, "model": seen, "residual": rng.normal(size=(VIEWS, CELLS)) / 10}
    rays |= {"angles_rad": np.deg2rad(np.arange(VIEWS) * 18 + 0.5)}
    image = {"phantom_image": rng.random((64, 64)), "phantom_field_mm": np.array(400.0)}
    outline, history = [(-100.0, 50.0), (100.0, 150.0), (-100.0, 50.0)], [(1.0, 0.4), (5.0, 0.1), (12.0, 0.002)]
    own = {**rays, **image, "phantom_outlines_mm": np.array(outline), "search_history": np.array(history)}
    return CalibrationArrays.of(own | changes)


LOG = {"log_row": np.array(5), "log_field_mm": np.array(330.0)}
LOG |= {"log_after": np.eye(32), "log_before": np.zeros((32, 32))}
STILL = {"angle_change_deg": -0.00001, "source_distance_change_mm": 0.0, "tilt_change_deg": 0.0}
MOVED = comparison(2.0, **STILL, reason="the rays moved 2.00 mm RMS where 0.50 mm is allowed")
MEASURED = {"dimension": "x", "measured_mm": 99.8, "standard_uncertainty_mm": 0.05, "measured_on": "2026-11-20"}
DISC = {"kind": "disc", "center_mm": (0, 0), "radius_mm": 50}
DRAWING = PhantomDrawing.model_validate({"name": "our cross", "shapes": [DISC], "measurements": [MEASURED]})
OF_SCAN = {"scanner_name": 'Line <2> "north"', "scanner_id": "line-2", "scan_name": "monday", "scan_id": "s1"}
IN_USE = {"tolerances": Tolerances(), "active": True, "activated": "since yesterday: by hand"}
MADE = {"calibration_id": "c1", "made_at": datetime(2026, 11, 22, 18, 44, tzinfo=EASTERN), "asked_by": "Maija"}
ABOUT = About(phantom=DRAWING, **OF_SCAN, **IN_USE, **MADE)


def page(result=None, about=ABOUT, its_arrays=None):
    html = report_html(result or answer(), about, its_arrays)
    addresses = re.findall(r"""(?:href|src|action)=["']?([^"'\s>]+)""", html)
    return SimpleNamespace(text=unescape(text_of(html)), addresses=addresses), html


def test_the_page_stands_alone_and_holds_both_parts_escaped():
    shown, html = page(its_arrays=arrays(**LOG))
    assert "<script" not in html.lower()
    assert html.count("<article") == 2
    for part in ('Calibration of Line <2> "north"', "2026-11-22 18:44 EET (UTC+02:00)", "monday", "Maija", "our cross"):
        assert part in shown.text.replace("L-shape", "our cross")
    assert "x 99.8 ± 0.05 mm (2026-11-20)" in shown.text
    assert "2 detector cells <without> a usable signal" in shown.text
    # The phantom, the log before and after, the residual, the search; each is a drawing of its own that loads nothing.
    assert len(shown.addresses) == 5
    for address in shown.addresses:
        kind, _, content = address.partition(",")
        assert kind == "data:image/svg+xml;base64"
        drawn = b64decode(content).decode()
        assert ET.fromstring(drawn).tag == "{http://www.w3.org/2000/svg}svg"  # noqa: S314 - our own text
        assert set(re.findall(r'href="(data:image/png|#|[^"])', drawn)) <= {"data:image/png", "#"}


def test_the_panels_are_in_the_reader_s_language():
    comma = Reader(str.upper, lambda value, digits: f"{value:.{digits}f}".replace(".", ","), "fi")
    urls = report_panels(answer(), arrays(), comma)
    panels = {name: b64decode(url.partition(",")[2]).decode() for name, url in urls.items()}
    assert "ANGLE OF THE VIEW, DEGREES" in panels["residual"]
    assert re.search(r">[^<>]?\d+,\d+<", panels["residual"])
    assert not any(re.search(r">[^<>]?\d+\.\d+<", svg) for svg in panels.values())


def test_the_log_before_names_its_geometry():
    geometries = {b"active": "with the calibration that was active"}
    geometries |= {b"unshifted": "uncalibrated: nothing shifted, nothing tilted"}
    for with_, words in geometries.items():
        log = LOG | {"log_before_with": np.array(with_)}
        assert f"The log before : row 5 of this scan, {words}" in page(its_arrays=arrays(**log))[0].text


def test_the_two_numbers_stand_beside_their_limits_and_angles_are_in_degrees_with_radians_beside_them():
    text = page()[0].text
    assert "Are the rays right? ✓ Yes 0.040 mm 95 % bound limit 0.100 mm" in text
    assert "Are the millimetres right? ✓ Yes ± 0.3 % = ± 0.9 mm on a log of 300 mm limit 0.5 % = 1.5 mm" in text
    assert "Nothing needs to be done." in text
    assert "Did anything move? ? Not known" in text
    assert "first angle \N{GREEK SMALL LETTER ALPHA} 0 146.1042° ± 5.7°" in text
    assert "2.550000 rad" in text
    # The slope 0.281 as an angle, and a correlation of the covariance.
    for words in ("detector tilt \N{GREEK SMALL LETTER ALPHA} D 15.6954°", "tan 0.281000", "+0.900", "345.2"):
        assert words in text


def test_the_page_says_where_the_pictures_are_and_which_panel_is_left_out():
    shown, _ = page()
    assert shown.addresses == []
    assert "A report of result.h5 shows them." in shown.text
    assert "The residual is in result.h5 and not in this file." in shown.text
    shown, _ = page(its_arrays=arrays(phantom_image=np.zeros((64, 64)), search_history=np.zeros((0, 2))))
    assert len(shown.addresses) == 1
    assert "No image: the views do not go all round." in shown.text


def test_what_is_not_known_is_shown_as_not_known():
    bare = {"standard_deviation": None, "covariance": None, "predicted_ray_error_mm": None, "hypotheses": []}
    earlier = {"limits": None, "status": None, "rays_verdict": None, "scale_uncertainty_percent": None}
    text = page(answer(**bare, **earlier), About(origin="RESULT.json"))[0].text
    assert text.count("Not known: this calibration") == 2
    for words in ("Made not known", "Held against not known", "no error bar", "In use not known", "RESULT.json"):
        assert words in text


BROKEN = {"verdict": "fail", "rays_verdict": "fail", "reasons": ["the fit broke"]}
# 1.96 times 0.9 of 917 mm is 0.19 %: half of 0.6 % is something else.
VAGUE = {"scale_uncertainty_percent": 0.6}


@pytest.mark.parametrize(
    ("changes", "active", "words"),
    [
        ({}, False, "and accept it. [Accept]"),
        (BROKEN, False, "[Scan again] the fit broke"),
        (BROKEN, True, "Go back to an earlier one."),
        ({"verdict": "watch", "rays_verdict": "watch", "reasons": ["turn it"]}, False, "[Scan again] turn it"),
        ({"predicted_ray_error_mm": None}, False, "Look at the pictures"),
        (
            VAGUE | {"reasons": ["more views"]},
            False,
            "For right sizes: Read the reason, which is in English. [Accept] more views",
        ),
        (VAGUE | {"scale_uncertainty_mm": 2.7}, True, "Measure the phantom, and enter its measured size."),
    ],
)
def test_what_to_do_next_is_one_sentence(changes, active, words):
    about = About(scanner_name="Line 2", active=active)
    assert words in page(answer(**changes), about)[0].text.partition("What to do next:")[2][:160]


def test_a_scanner_that_moved_is_no_reason_to_accept_at_once():
    text = page(answer(comparison=MOVED, reasons=[MOVED["reason"]]), About(active=False))[0].text
    assert "! Out of tolerance" not in text
    assert "✕ Out of tolerance Something has moved: 2.00 mm, and 0.50 mm is allowed." in text
    assert "If the scanner was changed on purpose, accept the newest calibration. [Scan again]" in text
    assert "✕ Out of tolerance." in text
    assert "first angle +0.000°" in text


BUDGET = [
    BudgetLine("noise", 0.5, 0.03, 0.06, 36.0, 0.03, 100.0, "A", "sum", "1"),
    BudgetLine("moisture", 0.5, 0.0, 0.0, None, 0.125, None, "B", "neither", "%", change=-0.4),
    BudgetLine("of a later version", None, 0.1, None, None, 0.0, None, "B", "bound", "", "allowance"),
]


def test_the_third_part_has_the_uncertainty_budget_and_what_it_is_not():
    shown, html = page(answer(uncertainty_budget=BUDGET))
    assert html.count("<article") == 3
    assert "noise of the samples A 0.5 0.06 0.03 36 0.03 100" in shown.text
    assert "moisture since the phantom was measured B 0.5 (-0.4) % 0 0 0.125" in shown.text
    assert "of a later version B * 0.1 0" in shown.text
    assert "The phantom has grown by -0.1 %: lengths" in shown.text
    assert "the sum is 0.02 mm; the 95 % bound is 0.04 mm, by draws" in shown.text
    assert "The phantom's ruler: x 99.8 ± 0.05 mm (2026-11-20)" in shown.text
    words = {"noise of the samples": "kohina"}
    finnish = Reader(lambda text: words.get(text, text), lambda value, _: f"{value:.1f}".replace(".", ","), "fi")
    html = report_html(answer(uncertainty_budget=BUDGET), ABOUT, None, finnish)
    assert "kohina A 0,5 0,06 0,03 36 0,03 100" in unescape(text_of(html))


def test_no_name_ends_the_style():
    escaped = '"a\\000022\\00003b\\000020\\00007d\\000020\\00003c\\00002fstyle\\00003e\\0000e9"'
    assert css_text('a"; } </style>é') == escaped


GREEN, AMBER, RED, ORANGE = (0x2E, 0x7D, 0x32), (0xB2, 0x6A, 0x00), (0xB7, 0x1C, 0x1C), (0xFF, 0x7F, 0x0E)
NO_ERROR_BARS = {"covariance": None, "standard_deviation": None, "predicted_ray_error_mm": None, "hypotheses": []}
HELD = np.outer(*[[1, 0, 1, 1, 1]] * 2) * VARIANCES
UNRESOLVED = {"theta": dict.fromkeys(THETA), "source_frame": dict.fromkeys(FRAME)}
# By verdict: what is not as in `answer` and `arrays`.
PICTURES = {
    "pass": ({"reasons": [MOVED["reason"], "the residual is not white"], "comparison": MOVED}, LOG),
    "watch": (
        {"covariance": HELD.tolist(), "theta_twin": None, "standard_deviation": UNRESOLVED},
        {
            "residual": np.ones((3, CELLS)),
            "angles_rad": np.array([4.0, 0.1, 2.0]),
            "phantom_image": np.zeros((64, 64)),
            **{name: values for name, values in LOG.items() if name != "log_before"},
        },
    ),
    "fail": (
        NO_ERROR_BARS | {"rays_verdict": "fail"},
        {"search_history": np.array([(64.0, -15_900.0), (128.0, -16_300.0)]), "residual": np.zeros((VIEWS, CELLS))},
    ),
}


def pixels(png):
    return np.asarray(Image.open(BytesIO(png)).convert("RGB")).astype(int)


def near(picture, color):
    return (np.abs(picture - np.array(color)).max(axis=2) < 40).sum()


def overlay(**changes):
    return pixels(overlay_png(arrays(**changes)))


@cache
def picture(verdict):
    changes, others = PICTURES[verdict]
    return pixels(report_png(answer(**changes, verdict=verdict), arrays(**others)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("verdict", "color", "pairs"),
    [("pass", RED, 10), ("watch", AMBER, 6), ("fail", RED, 0)],
    ids=[
        "moved too far, two pictures of a log",
        "R held, no twin, three views unsorted, no image, one picture of a log",
        "no error bars, a correlation, perfect fit",
    ],
)
def test_the_picture_has_its_next_step_s_color_and_what_there_is(verdict, color, pairs):
    drawn = picture(verdict)
    assert drawn.shape[1] == 1400
    badge = drawn[:70, -250:]
    # A badge's face has some 2 000 pixels.
    assert near(badge, color) > 1000
    assert all(near(badge, other) == 0 for other in {GREEN, AMBER, RED} - {color})
    filled = (np.abs(drawn - np.array((0xC7, 0xDD, 0xEC))).max(axis=2) < 4).sum()  # a quarter of blue on white
    # Ten pairs share a square of 4 x 4 panels, six one of 3 x 3: about 9 000 and 17 000 pixels each.
    assert 6_000 * pairs < filled + 1 < 20_000 * pairs + 100


@pytest.mark.slow
def test_sentences_make_the_picture_longer_and_what_moved_too_far_is_red():
    drawn = picture("pass")
    # Head with six lines, what was found, log, fit and pairs, at 100 pixels an inch; a page's height is whole.
    assert abs(drawn.shape[0] - 100 * (1.0 + 6 * 0.27 + 6.1 + 6.6 + 5.4 + 6.4)) <= 1
    assert near(drawn[80:200, :700], RED) > 200


@pytest.mark.slow
def test_a_log_after_stands_alone_where_there_is_none_before():
    middle = picture("watch")[900:1300, 850:1150]
    assert near(middle, (0, 0, 0)) > 0.5 * middle.shape[0] * middle.shape[1]


@pytest.mark.slow
def test_an_image_by_another_method_says_so_in_its_title():
    by_fbp, named = overlay(), overlay(phantom_image_method=np.array(b"total_variation"))
    assert named.shape != by_fbp.shape or (named != by_fbp).any()
    assert (overlay(phantom_image_method=np.array(b"fbp")) == by_fbp).all()


def test_views_and_angles_that_disagree():
    with pytest.raises(ValueError, match=r"residual \(20, 48\) and 19 angles do not agree"):
        report_panels(answer(), arrays(angles_rad=np.arange(19.0)))


@pytest.mark.slow
def test_outline_lies_where_x_is_down_and_y_is_right():
    outline = np.array([(-190.0, 100.0), (-190.0, 190.0), (-150.0, 190.0), (-150.0, 100.0), (-190.0, 100.0)])
    drawn = overlay(phantom_image=np.zeros((64, 64)), phantom_outlines_mm=outline)
    panel = np.argwhere(drawn.max(axis=2) < 60)
    top, left = panel.min(axis=0)
    bottom, right = panel.max(axis=0)
    row, column = np.argwhere(np.abs(drawn - np.array(ORANGE)).max(axis=2) < 40).mean(axis=0)
    assert row < top + (bottom - top) / 3
    assert column > left + (right - left) / 2


@pytest.mark.slow
def test_a_gap_between_outlines_is_not_drawn():
    square = np.array([(-50.0, -50.0), (-50.0, 50.0), (50.0, 50.0), (50.0, -50.0), (-50.0, -50.0)]) / 2.0
    two = np.concatenate([square - 120.0, np.full((1, 2), np.nan), square + 120.0])
    black = {"phantom_image": np.zeros((64, 64))}
    drawn, line = (
        near(overlay(**black, phantom_outlines_mm=these), ORANGE) for these in (two, np.delete(two, 5, axis=0))
    )
    # The line from one square to the other is about as long as both of them.
    assert line > 1.3 * drawn


def test_the_table_has_each_value_with_its_deviation():
    spreads = {"theta": dict.fromkeys(THETA, 0.01), "source_frame": dict.fromkeys(FRAME, 0.02)}
    table = dict(calibration_table(answer(standard_deviation=spreads)))
    assert (table["source to COR R"], table["first angle alpha_0"]) == ("917.100 mm ± 0.02 mm", "146.1042° ± 0.57°")
    assert table["detector tilt alpha_D"] == "15.6954° ± 0.53°"
    assert table["  next best"] == "from-behind / as-given, 0.10% unexplained"
    bare = dict(calibration_table(answer(standard_deviation=None, predicted_ray_error_mm=None)))
    assert bare["source to COR R"] == "917.100 mm no error bar"
    assert "predicted ray error" not in bare
