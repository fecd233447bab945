"""Units of lengths and angles in files: each against its value in mm or degrees."""

import math

import numpy as np
import pytest

from sawmill_formats.input import field_names

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
    assert field_names.length_of(np.array([2.5]), f" {unit.upper() if unit.isascii() else unit} ") == (
        2.5 * factor,
        None,
    )


@pytest.mark.parametrize(("unit", "factor"), of_each(IN_DEGREES))
def test_an_angle_is_read_in_its_unit(unit, factor):
    for written in (unit, unit.upper(), f" {unit.title()} "):
        np.testing.assert_allclose(
            field_names.to_degrees(np.array([0.5, -2.0]), written), [0.5 * factor, -2.0 * factor]
        )


def test_every_unit_is_tried():
    assert set(field_names.LENGTHS_MM) == {unit for unit, _ in of_each(IN_MM)}
    assert {unit for unit, _ in of_each(IN_DEGREES)} == field_names.DEGREES | field_names.RADIANS
