"""The science's values are the contract's: what crosses a boundary as JSON comes back as it was."""

import json
from dataclasses import fields

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from sawmill_calibration.known_geometry import from_phantom, to_phantom
from sawmill_contracts import geometry
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS, PhantomDrawing
from sawmill_tomography.geometry.geometry import to_vector
from sawmill_tomography.phantoms import built_in
from sawmill_vocabulary import Disc, Polygon, Scanner, SourceFrame, Theta, ThetaBounds


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
    assert list(geometry.SourceFrameDeviation.model_fields) == [
        *(one.name for one in fields(SourceFrame)),
        "magnification",
    ]


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
