from functools import cache
from io import BytesIO

import numpy as np
import pytest
from PIL import Image
from results import CONSTANTS, FRAME, SEARCH, THETA, calibration_result

from sawmill_contracts.calibrations import CalibrationResult
from sawmill_vocabulary.calibration_arrays import CalibrationArrays
from sawmill_worker.pictures.calibration_report import overlay_png, report_png
from sawmill_worker.pictures.report_numbers import calibration_table

pytestmark = pytest.mark.slow

FIELD_MM = 400.0
VARIANCES = np.array([1e-8, 0.2, 0.8, 1e-4, 1e-6])


def report(answer, arrays):
    return report_png(CalibrationResult.model_validate(answer), CalibrationArrays.of(arrays))


def overlay(answer, arrays):
    return overlay_png(CalibrationResult.model_validate(answer), CalibrationArrays.of(arrays))


def table_of(answer):
    return dict(calibration_table(CalibrationResult.model_validate(answer)))


@pytest.fixture(scope="module")
def answer():
    deviations = {"theta": dict.fromkeys(THETA, 0.01), "source_frame": dict.fromkeys(FRAME, 0.02)}
    hypothesis = {"handedness": "as-drawn", "rotation": "as-given", "relative_residual": 0.001}
    return calibration_result(
        theta_twin=THETA | {"source_shift_mm": -319.9, "initial_angle_rad": 3.26},
        standard_deviation=deviations,
        covariance=np.diag(VARIANCES).tolist(),
        hypotheses=[hypothesis, hypothesis | {"handedness": "from-behind", "relative_residual": 0.15}],
        phantom_position_mm=[0.03, 0.02],
        status=None,
        adjustments=["2 detector cells without a usable signal were left out"],
        scanner=CONSTANTS | {"num_detector_pixels": 48},
        rows=[0, 3],
        search=SEARCH | {"method": "multi-start", "evaluations": 12, "best_value": 0.002},
        timing_s={"total": 0.2, "search": 0.1, "refine": 0.05, "uncertainty": 0.05},
    )


@pytest.fixture(scope="module")
def arrays():
    rng = np.random.default_rng(20261120)
    return {
        "sinogram": np.ones((20, 48)),
        "model": np.ones((20, 48)),
        "residual": rng.normal(size=(20, 48)) / 10,
        "angles_rad": np.deg2rad(np.arange(20) * 18 + 0.5),
        "phantom_image": rng.random((64, 64)),
        "phantom_field_mm": np.array(FIELD_MM),
        "phantom_outlines_mm": np.array([(-100.0, 51.5), (100.0, 150.0), (100.0, -150.0), (-100.0, 51.5)]),
        "search_history": np.array([(1.0, 0.4), (5.0, 0.1), (12.0, 0.002)]),
    }


def pixels(png):
    return np.asarray(Image.open(BytesIO(png)).convert("RGB")).astype(int)


def near(page, color):
    return (np.abs(page - np.array(color)).max(axis=2) < 40).sum()


GREEN, AMBER, RED, ORANGE = (0x2E, 0x7D, 0x32), (0xB2, 0x6A, 0x00), (0xB7, 0x1C, 0x1C), (0xFF, 0x7F, 0x0E)
BLUE = (0x1F, 0x77, 0xB4)


HELD = {"covariance": np.diag(VARIANCES * [1, 0, 1, 1, 1]).tolist(), "theta_twin": None}
NO_ERROR_BARS = {"covariance": None, "standard_deviation": None, "predicted_ray_error_mm": None, "hypotheses": []}
UNRESOLVED = {"standard_deviation": {"theta": dict.fromkeys(THETA), "source_frame": dict.fromkeys(FRAME)}}
THREE_VIEWS = {
    "residual": np.ones((3, 48)),
    "angles_rad": np.array([4.0, 0.1, 2.0]),
    "phantom_image": np.zeros((64, 64)),
}
CORRELATION = {"search_history": np.array([(64.0, -15_900.0), (128.0, -16_300.0)])}
NOTHING_LEFT = {"search_history": np.zeros((0, 2)), "residual": np.zeros((20, 48))}


MOVED = {
    "calibration_id": "example",
    "ray_change_mm": 2.0,
    "angle_change_deg": 0.0,
    "cor_column_change_mm": 2.0,
    "source_distance_change_mm": 0.0,
    "tilt_change_deg": 0.0,
    "within_tolerance": False,
    "reason": "the rays moved 2.00 mm RMS where 0.50 mm is allowed",
}
SENTENCES = {"reasons": [MOVED["reason"], "the residual is not white"], "comparison": MOVED}
LOG = {"log_row": np.array(5), "log_field_mm": np.array(330.0), "log_after": np.eye(32)}
# By verdict: what is not as in `answer` and `arrays`.
PAGES = {
    "pass": (SENTENCES, LOG | {"log_before": np.zeros((32, 32))}),
    "watch": (HELD | UNRESOLVED, THREE_VIEWS | LOG),
    "fail": (NO_ERROR_BARS, CORRELATION | NOTHING_LEFT),
}


@pytest.fixture(scope="module")
def page(answer, arrays):
    """Draw a page once: the pixels of the report with a verdict."""

    @cache
    def draw(verdict):
        other_answer, other_arrays = PAGES[verdict]
        return pixels(report(answer | other_answer | {"verdict": verdict}, arrays | other_arrays))

    return draw


@pytest.mark.parametrize(
    ("verdict", "color", "pairs"),
    [("pass", RED, 10), ("watch", AMBER, 6), ("fail", RED, 0)],
    ids=[
        "moved too far, two pictures of a log",
        "R held, no twin, three views unsorted, no image, one picture of a log",
        "no error bars, no history, perfect fit",
    ],
)
def test_the_report_has_its_next_steps_color_and_what_there_is(page, verdict, color, pairs):
    drawn = page(verdict)
    assert drawn.shape[1] == 1400
    badge = drawn[:70, -250:]
    # A badge's face has some 2 000 pixels.
    assert near(badge, color) > 1000
    assert all(near(badge, other) == 0 for other in {GREEN, AMBER, RED} - {color})
    filled = (np.abs(drawn - np.array((0xC7, 0xDD, 0xEC))).max(axis=2) < 4).sum()  # a quarter of blue on white
    # Ten pairs share a square of 4 x 4 panels, six one of 3 x 3: about 9 000 and 17 000 pixels each.
    assert 6_000 * pairs < filled + 1 < 20_000 * pairs + 100


def test_sentences_make_the_page_longer_and_what_moved_too_far_is_red(page):
    drawn = page("pass")
    # Head with six lines, what was found, log, fit and pairs, at 100 pixels an inch; a page's height is whole.
    assert abs(drawn.shape[0] - 100 * (1.0 + 6 * 0.27 + 6.1 + 6.6 + 5.4 + 6.4)) <= 1
    assert near(drawn[80:200, :700], RED) > 200


def test_one_picture_of_a_log_stands_alone(page):
    middle = page("watch")[900:1300, 850:1150]
    assert near(middle, (0, 0, 0)) > 0.5 * middle.shape[0] * middle.shape[1]


def test_an_image_by_another_method_says_so_in_its_title(answer, arrays):
    by_fbp = pixels(overlay(answer, arrays))
    named = pixels(overlay(answer, arrays | {"phantom_image_method": np.array(b"total_variation")}))
    assert named.shape != by_fbp.shape or (named != by_fbp).any()


def test_same_input_same_bytes(answer, arrays):
    assert overlay(answer, arrays) == overlay(answer, arrays | {"phantom_image_method": np.array(b"fbp")})


def test_views_and_angles_that_disagree(answer, arrays):
    with pytest.raises(ValueError, match=r"residual \(20, 48\) and 19 angles do not agree"):
        report(answer, arrays | {"angles_rad": np.arange(19.0)})


def test_outline_lies_where_x_is_down_and_y_is_right(answer, arrays):
    outline = np.array([(-190.0, 100.0), (-190.0, 190.0), (-150.0, 190.0), (-150.0, 100.0), (-190.0, 100.0)])
    black = {"phantom_image": np.zeros((64, 64)), "phantom_outlines_mm": outline}
    page = pixels(overlay(answer, arrays | black))
    panel = np.argwhere(page.max(axis=2) < 60)
    top, left = panel.min(axis=0)
    bottom, right = panel.max(axis=0)
    row, column = np.argwhere(np.abs(page - np.array(ORANGE)).max(axis=2) < 40).mean(axis=0)
    assert row < top + (bottom - top) / 3
    assert column > left + (right - left) / 2


def test_a_gap_between_outlines_is_not_drawn(answer, arrays):
    square = np.array([(-50.0, -50.0), (-50.0, 50.0), (50.0, 50.0), (50.0, -50.0), (-50.0, -50.0)]) / 2.0
    two = np.concatenate([square - 120.0, np.full((1, 2), np.nan), square + 120.0])
    black = arrays | {"phantom_image": np.zeros((64, 64))}
    drawn, line = (
        near(pixels(overlay(answer, black | {"phantom_outlines_mm": these})), ORANGE)
        for these in (two, np.delete(two, 5, axis=0))
    )
    # The line from one square to the other is about as long as both of them.
    assert line > 1.3 * drawn


def test_the_table_has_each_value_with_its_deviation(answer):
    table = table_of(answer)
    assert table["source distance R"] == "917.100 ± 0.02 mm"
    assert table["first angle alpha0"] == "146.1042 ± 0.57 °"
    assert table["  next best"] == "from-behind / as-given, 15.00% unexplained"
    bare = table_of(answer | {"standard_deviation": None, "predicted_ray_error_mm": None})
    assert bare["source distance R"] == "917.100 mm"
    assert "predicted ray error" not in bare
