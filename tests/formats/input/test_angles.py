"""Angles as they are given and as files have them, and units of lengths and angles."""

import math
import os

import numpy as np
import pytest

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AngleList, AngleSteps, parse_angles, read_angles_file
from sawmill_formats.input.contents import DEGREES, LENGTHS_MM, RADIANS, FileContents, held, length_of, to_degrees
from sawmill_formats.input.reading import agree_on_angles
from sawmill_vocabulary.reading_messages import ReadingMessage


def test_a_start_with_its_step_is_a_sequence_and_a_step_of_nothing_is_refused():
    np.testing.assert_array_equal(AngleSteps(0.5, 1.0).expand(3), [0.5, 1.5, 2.5])
    np.testing.assert_array_equal(AngleSteps(10.0, -2.5).expand(3), [10.0, 7.5, 5.0])
    with pytest.raises(UnreadableScan, match="must not be 0 degrees"):
        parse_angles("5:0")


@pytest.mark.parametrize(
    ("text", "angles"),
    [
        ("0.5:1", AngleSteps(0.5, 1.0)),
        ("10 : -2.5", AngleSteps(10.0, -2.5)),
        ("0,5:1,25", AngleSteps(0.5, 1.25)),
        ("0, 1.5,-2e1", AngleList((0.0, 1.5, -20.0))),
        ("0,5; 1.5;2", AngleList((0.5, 1.5, 2.0))),
    ],
)
def test_steps_and_lists_are_read_with_points_or_commas(text, angles):
    assert parse_angles(text) == angles


@pytest.mark.parametrize("text", ["", "a:1", "0:1:2", "1,,2", "nan", "inf:1", "0:", "zero"])
def test_anything_else_is_refused(text):
    with pytest.raises(UnreadableScan, match=r"START:STEP, as in 0\.5:1") as refusal:
        parse_angles(text)
    assert refusal.value.code == "angles-malformed"


def test_file_with_comments(tmp_path):
    path = tmp_path / "angles.txt"
    path.write_text("# degrees\n0.5\n\n1.25 # the second\n  300\n", encoding="utf-8-sig")
    assert read_angles_file(path) == AngleList((0.5, 1.25, 300.0))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [(b"# none\n", "holds no angle"), (b"\xff\xfe\x00", "is not a text"), (b"0\nx\n", "not 'x'")],
)
def test_file_that_is_no_list(tmp_path, content, sentence):
    path = tmp_path / "angles.txt"
    path.write_bytes(content)
    with pytest.raises(UnreadableScan, match=sentence):
        read_angles_file(path)


def test_file_that_is_too_large_is_not_read(tmp_path):
    path = tmp_path / "angles.txt"
    path.touch()
    os.truncate(path, 17 * 2**20)
    with pytest.raises(UnreadableScan, match="too large for a list of angles"):
        read_angles_file(path)


# Views, their step, and the degrees that the remark states.
STEPS = [
    (90, 4.0, None),
    (91, 4.0, None),
    (92, 4.0, "368"),
    (89, 4.0, "356"),
    (103, -3.5, None),
    (720, 1.0, None),
    (1080, 0.333333, None),
    (515, 0.7, None),
    (180, 1.0, "180"),
    (200, 1.0, None),
    (60, -4.0, None),
    (250, 1.0, "250"),
    (768, 4.0, "3072"),
    (90, 222.4922359, None),
    (6, 1.0, "6"),
]


@pytest.mark.parametrize(("views", "step_deg", "covered_deg"), STEPS)
def test_steps_that_make_no_whole_turns_are_remarked(views, step_deg, covered_deg):
    contents = FileContents("npy", held(np.zeros((views, 4), np.float32)))
    angles_deg, remarks = agree_on_angles(contents, AngleSteps(0.5, step_deg))
    assert angles_deg.tolist() == [0.5 + step_deg * n for n in range(views)]
    assert [(remark.message, remark.values["covered_deg"]) for remark in remarks] == (
        [] if covered_deg is None else [(ReadingMessage.NO_WHOLE_TURN, covered_deg)]
    )
    assert agree_on_angles(contents, AngleList(tuple(angles_deg)))[1] == ()


IN_MM = {
    1e-6: ["nm", "nanometer", "nanometers", "nanometre", "nanometres"],
    1e-3: ["um", "\u00b5m", "\u03bcm", "micron", "microns", "micrometer", "micrometers", "micrometre", "micrometres"],
    1.0: ["mm", "millimeter", "millimeters", "millimetre", "millimetres"],
    10.0: ["cm", "centimeter", "centimeters", "centimetre", "centimetres"],
    25.4: ["in", "inch", "inches"],
    1000.0: ["m", "meter", "meters", "metre", "metres"],
}
IN_DEGREES = {1.0: ["deg", "degree", "degrees", "°"], 180.0 / math.pi: ["rad", "radian", "radians"]}


def of_each(factors):
    return [(unit, factor) for factor, names in factors.items() for unit in names]


@pytest.mark.parametrize(("unit", "factor"), of_each(IN_MM))
def test_a_length_is_read_in_its_unit(unit, factor):
    assert length_of(np.array([2.5]), f" {unit.upper() if unit.isascii() else unit} ") == (2.5 * factor, None)


@pytest.mark.parametrize(("unit", "factor"), of_each(IN_DEGREES))
def test_an_angle_is_read_in_its_unit(unit, factor):
    for written in (unit, unit.upper(), f" {unit.title()} "):
        np.testing.assert_allclose(to_degrees(np.array([0.5, -2.0]), written), [0.5 * factor, -2.0 * factor])


def test_every_unit_is_tried():
    assert set(LENGTHS_MM) == {unit for unit, _ in of_each(IN_MM)}
    assert {unit for unit, _ in of_each(IN_DEGREES)} == DEGREES | RADIANS
