"""Values, pictures and choices that cannot be used: each ends in one sentence, none in an exception of arithmetic."""

import math
import random
import re

import numpy as np
import pytest
from PIL import Image
from pydantic import TypeAdapter, ValidationError

import sawmill_calibration
from sawmill_calibration import Disc, InputError, Phantom, Polygon, Scanner, Theta
from sawmill_calibration.calibration.calibrate import CalibrationInput, run_calibration
from sawmill_calibration.calibration.plan import run_plan
from sawmill_calibration.failures import input_errors_translated, options_of, read_json
from sawmill_calibration.known_geometry import traced_drawing
from sawmill_calibration.scans.scan_rows import chosen_rows, chosen_views
from sawmill_contracts.calibrations import CalibrationOptions
from sawmill_contracts.geometry import GivenTheta, ScannerConstants
from sawmill_contracts.phantoms import PhantomRequest
from sawmill_contracts.plans import PlanOptions
from sawmill_contracts.reconstructions import ReconstructionOptions
from sawmill_formats.errors import UnreadableScan
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.jobs import FailureKind
from sawmill_tomography.calibration.refusals import CalibrationError
from sawmill_tomography.geometry.geometry import GeometryError
from sawmill_tomography.phantoms.phantom import PhantomError
from sawmill_tomography.preparing.line_integrals import CountsError

SCANNER = Scanner(859.46, 32, 36.0)
THETA = Theta(0.9, 710.0, 240.0, 35.0, 0.2)
VIEWS = 20


def simulated(phantom="l-shape", **options):
    return sawmill_calibration.simulate_phantom_scan(phantom, SCANNER, THETA, **{"views": VIEWS} | options)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"views": 0}, "views: Input should be greater than or equal to 1"),
        ({"views": 10**9}, "views: Input should be less than or equal to 100000"),
        ({"rows": 0}, "rows: Input should be greater than or equal to 1"),
        ({"rows": 10**9}, "rows: Input should be less than or equal to 100000"),
        ({"noise": math.nan}, "noise: Input should be a finite number"),
        ({"background": 1e308}, "background: Input should be less than or equal to 100000"),
        ({"photons": -1.0, "physics": {}}, "photons: Input should be greater than or equal to 1"),
        ({"seed": -1}, "seed: Input should be greater than or equal to 0"),
    ],
)
def test_a_scan_that_cannot_be_simulated_is_refused(options, sentence):
    with pytest.raises(InputError, match=sentence):
        simulated(**options)


@pytest.mark.parametrize(
    ("written", "right"),
    [
        ('{"beam": {"energy_spread": "0.1"}}', "energy_spread: Input should be a valid number"),
        ('{"wood": {"knots": true}}', "knots: Input should be a valid integer"),
    ],
)
def test_a_file_of_physics_is_taken_as_itself(tmp_path, written, right):
    path = tmp_path / "physics.json"
    path.write_text(written)
    with pytest.raises(InputError, match=right):
        simulated(physics=path)


@pytest.mark.parametrize("density", [1e300, math.nan, math.inf])
def test_a_density_beyond_computing_is_refused(density):
    with pytest.raises(ValueError, match="density must lie within ±1e"):
        Phantom("p", (Disc((0.0, 0.0), 60.0, density),))


@pytest.mark.parametrize(
    ("limits", "sentence"),
    [
        ({"tolerance_mm": math.nan}, "tolerance_mm: Input should be a finite number"),
        ({"scale_tolerance_percent": 0.0}, "scale_tolerance_percent: Input should be greater than 0"),
        ({"log_radius_mm": 1e4}, "log_radius_mm 10000 must be less than source_to_cor_mm 859.46"),
    ],
)
def test_limits_that_nothing_can_be_held_against_are_refused(limits, sentence):
    with pytest.raises(InputError, match=sentence):
        sawmill_calibration.calibrate(simulated(), "l-shape", **limits)


@pytest.mark.parametrize(
    "shapes",
    [
        (Disc((0.0, 0.0), 1e-9),),
        (Disc((0.0, 0.0), 60.0, 0.0),),
        (Disc((0.0, 0.0), 60.0),),
        (Disc((1e5, 0.0), 60.0),),
        (Polygon(((-900.0, -900.0), (900.0, -900.0), (0.0, 900.0))),),
        (Disc((0.0, 0.0), 60.0), Disc((0.0, 0.0), 60.0, -1.0)),
    ],
)
def test_a_phantom_that_shows_no_geometry_ends_in_a_sentence(shapes):
    with pytest.raises(InputError, match=r"phantom|wood"):
        sawmill_calibration.calibrate(simulated(), Phantom("p", shapes))


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"method": "tikhonov", "alpha": 1e-300}, "alpha: must be from 1e-09 to 1e+09, not 1e-300"),
        ({"method": "cauchy_map", "sigma": 1e300, "beta": 1.0}, "sigma: must be from 1e-09 to 1e+09, not 1e+300"),
        ({"method": "cauchy_map", "sigma": 1.0, "beta": 1e-300}, "beta: must be from 1e-09 to 1e+09, not 1e-300"),
        ({"method": "total_variation", "weight": 1e300}, "weight: must be from 1e-09 to 1e+09, not 1e+300"),
        ({"field_mm": 1e-300}, "field_mm: must be from 0.01 to 100000, not 1e-300"),
    ],
)
def test_parameters_beyond_computing_are_refused(options, sentence):
    with pytest.raises(InputError, match=re.escape(sentence)):
        sawmill_calibration.reconstruct(simulated(), THETA, size=16, **options)


ENDLESS = []
ENDLESS.append(ENDLESS)


@pytest.mark.parametrize("rows", ["\ud800", ENDLESS], ids=["half a surrogate", "a list that holds itself"])
def test_options_that_no_json_holds_are_refused(rows):
    with pytest.raises(InputError, match="an option cannot be read: "):
        options_of(ReconstructionOptions, {"rows": rows})


@pytest.mark.parametrize("written", [180.0, np.float64(180), np.float32(180), np.int64(180)])
def test_a_whole_number_may_be_written_as_a_float(tmp_path, written):
    assert options_of(ReconstructionOptions, {"views": written}).views == 180
    path = tmp_path / "options.json"
    path.write_bytes(b'\xef\xbb\xbf{"views": %r}' % float(written))
    assert read_json(path, ReconstructionOptions, code="options", otherwise="no options").views == 180
    with pytest.raises(InputError, match=r"views: Input should be a valid integer$"):
        options_of(ReconstructionOptions, {"views": 180.5})


@pytest.mark.parametrize(
    "options",
    [
        {"method": "tikhonov", "alpha": 1e-9},
        {"method": "tikhonov", "alpha": 1e9},
        {"method": "cauchy_map", "sigma": 1e-9, "beta": 1e-9},
        {"method": "cauchy_map", "sigma": 1e9, "beta": 1e9},
        {"method": "total_variation", "weight": 1e9},
        {"method": "total_variation", "weight": 1e-9},
        {"method": "fbp", "field_mm": 1e-2},
    ],
)
def test_parameters_at_their_bounds_give_finite_images(options):
    assert np.isfinite(sawmill_calibration.reconstruct(simulated(), THETA, size=16, **options).volume).all()


def some(draw, usual, least, largest):
    """The usual value, else one between the bounds of its contract, all magnitudes alike, or a bound itself."""
    if draw.random() < 0.9:
        return usual
    magnitude = 10.0 ** draw.uniform(-9, math.log10(largest))
    return draw.choice([least, largest, min(max(draw.choice([-1, 1]) * magnitude, least), largest)])


def some_drawing(draw):
    shapes = []
    for _ in range(draw.randint(1, 3)):
        x, y = some(draw, 0.0, -1e5, 1e5), some(draw, 30.0, -1e5, 1e5)
        width, height = some(draw, 80.0, 0.1, 1e5), some(draw, 50.0, 0.1, 1e5)
        density = draw.choice([1.0, 1.0, -1.0, 0.0, 1e-6, 1000.0])
        corners = [(x, y), (x + width, y), (x + 0.3 * width, y + height), (x, y + height)]
        disc = {"kind": "disc", "center_mm": (x, y), "radius_mm": width, "density": density}
        shapes.append(draw.choice([disc, {"kind": "polygon", "vertices_mm": corners, "density": density}]))
    return PhantomRequest(name="p", shapes=shapes)


def some_scanner(draw):
    given = {
        "source_to_cor_mm": some(draw, 859.46, 1.0, 1e5),
        "num_detector_pixels": draw.choice([8, 32]),
        "detector_pitch_mm": some(draw, 36.0, 1e-3, 1e5),
    }
    return TypeAdapter(ScannerConstants).validate_python(given)


def some_theta(draw):
    given = {
        "initial_angle_rad": some(draw, 0.9, -1000.0, 1000.0),
        "detector_to_cor_mm": some(draw, 710.0, 1e-9, 1e5),
        "source_shift_mm": some(draw, 240.0, -1e5, 1e5),
        "detector_shift_mm": some(draw, 35.0, -1e5, 1e5),
        "detector_tilt": some(draw, 0.2, -10.0, 10.0),
    }
    return TypeAdapter(GivenTheta).validate_python(given)


def outcomes_of(count, seed, answer):
    """How many of random drawings on random scanners are refused, fail with a sentence, and are answered."""
    draw = random.Random(seed)  # noqa: S311 - of a test
    found = {"refused": 0, "failed": 0, "answered": 0}
    for _ in range(count):
        try:
            drawing, scanner, theta = some_drawing(draw), some_scanner(draw), some_theta(draw)
        except ValidationError:
            found["refused"] += 1
            continue
        try:
            with np.errstate(divide="raise", over="raise", invalid="raise"), input_errors_translated():
                answer(draw, drawing, scanner, theta)
            found["answered"] += 1
        except JobFailure as failure:
            assert failure.detail  # noqa: PT017 - what the failure says is the subject
            found["failed"] += 1
    return found


def test_a_plan_of_anything_is_an_answer_or_a_sentence():
    def plan(draw, drawing, scanner, theta):
        radius_mm = draw.choice([None, 1e-9, 150.0, 1e5])
        options = PlanOptions(views=draw.choice([3, VIEWS]), noise=draw.choice([0.02, 1e-9, 1.0]))
        run_plan(drawing, scanner, theta, options, radius_mm)

    assert min(outcomes_of(400, 3, plan).values()) > 30


@pytest.mark.slow
def test_a_calibration_with_anything_is_an_answer_or_a_sentence():
    """The scan is of the L, and what it is said to show is something else."""
    scan = simulated(noise=0.01)
    sinogram = scan.line_integrals.mean(axis=1, dtype=np.float64)

    def calibrate(_draw, drawing, scanner, _theta):
        cells = sinogram[:, : scanner.num_detector_pixels]
        given = CalibrationInput(cells, scan.angles_rad, (0, 1), scanner, None, drawing, "0" * 64)
        run_calibration(given, CalibrationOptions(), lambda _: None)

    assert outcomes_of(16, 5, calibrate)["failed"] > 3


def square(side):
    picture = np.zeros((side, side), np.uint8)
    picture[side // 4 : side // 2, side // 4 : side // 2] = 255
    return picture


def spiral(side):
    """One line of 1.5 pixels, wound up to the border."""
    y, x = np.mgrid[:side, :side] - 0.5 * (side - 1)
    turns, radius = np.arctan2(y, x) / (2.0 * np.pi), np.hypot(x, y)
    on_line = (radius / 3.0 - turns) % 1.0 < 0.5
    return np.where(on_line & (radius > 4.0) & (radius < 0.5 * side - 4.0), 255, 0).astype(np.uint8)


@pytest.mark.parametrize(
    ("picture", "width_mm", "sentence"),
    [
        (spiral(360), 400.0, "an outline of the picture has more than 2000 corners, .*: give a clean drawing"),
        (
            square(40),
            1e9,
            "the picture shows no phantom that can be drawn: Input should be greater than or equal to -100000",
        ),
        (square(40), 1e-300, r"the picture's width is 1e-300 mm: give the width .*, at least 0\.1 mm"),
    ],
    ids=["spiral", "too large", "no width"],
)
def test_what_no_drawing_can_be_made_of_is_refused(tmp_path, picture, width_mm, sentence):
    path = tmp_path / "picture.png"
    Image.fromarray(picture).save(path)
    with pytest.raises(JobFailure, match=sentence) as failure, input_errors_translated():
        traced_drawing(path, width_mm, name="none")
    assert failure.value.code == "phantom"


def test_rows_are_those_named_or_all_and_refused_where_there_are_none():
    assert chosen_rows(None, 5) == slice(0, 5)
    assert chosen_rows("1:3", 5) == slice(1, 3)
    assert chosen_rows("4:5", 5) == slice(4, 5)
    assert chosen_rows("0:5:2", 5) == slice(0, 5, 2)
    with pytest.raises(JobFailure, match="rows 4:6 were asked for, but the scan has rows 0:5") as refusal:
        chosen_rows("4:6", 5)
    assert (refusal.value.kind, refusal.value.code) == (FailureKind.INPUT, "rows-outside")


@pytest.mark.parametrize(("views", "available"), [(20, 360), (45, 360), (7, 360), (360, 360), (100, 360), (3, 4)])
def test_views_are_spread_evenly_and_start_with_the_first(views, available):
    chosen = chosen_views(views, available)
    assert chosen[0] == 0
    assert chosen.size == np.unique(chosen).size == views
    gaps = np.diff([*chosen, available])
    assert gaps.max() - gaps.min() <= 1


def test_all_views_are_used_by_default_and_no_more_than_there_are():
    assert np.array_equal(chosen_views(None, 4), [0, 1, 2, 3])
    assert np.array_equal(chosen_views(None, 6, [0, 4]), [1, 2, 3, 5])
    assert np.array_equal(chosen_views(2, 6, [0, 4]), [1, 3])
    with pytest.raises(JobFailure, match="6 of which 2 are corrupt"):
        chosen_views(5, 6, [0, 4])
    with pytest.raises(JobFailure, match="361 views were asked for, but the scan has 360"):
        chosen_views(361, 360)


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (UnreadableScan("empty-file", "the file is empty"), "empty-file"),
        (CalibrationError("phantom-not-seen", "no phantom"), "phantom-not-seen"),
        (GeometryError("no geometry"), "geometry"),
        (PhantomError("no phantom"), "phantom"),
        (CountsError("no counts"), "counts"),
    ],
)
def test_unusable_input_is_the_askers_to_mend(error, code):
    with pytest.raises(JobFailure) as failure, input_errors_translated():
        raise error
    assert (failure.value.kind, failure.value.code, failure.value.detail) == (FailureKind.INPUT, code, str(error))
    assert failure.value.__cause__ is error


@pytest.mark.parametrize("error", [ValueError("a defect"), OSError("the disk"), MemoryError()])
def test_everything_else_passes_through(error):
    with pytest.raises(type(error)) as passed, input_errors_translated():
        raise error
    assert passed.value is error
