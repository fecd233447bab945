"""From contracts to the science and back nothing is lost."""

import pytest

from sawmill_worker.contracts import calibrations as contracts
from sawmill_worker.contracts.built_in import BUILT_IN_PHANTOMS
from sawmill_worker.contracts.geometry import ThetaBounds
from sawmill_worker.contracts.phantoms import DiscShape, PhantomDrawing, PolygonShape
from sawmill_worker.tomography import built_in
from sawmill_worker.tomography.geometry import ThetaBounds as Bounds
from sawmill_worker.use_cases.conversion import (
    from_frame,
    from_phantom,
    from_theta,
    to_bounds,
    to_frame,
    to_phantom,
    to_scanner,
    to_theta,
)
from sawmill_worker.vocabulary import Adjustment, CalibrationStatus


def test_both_sides_know_the_same_adjustments_and_statuses():
    assert [one.value for one in contracts.Adjustment] == [one.value for one in Adjustment]
    assert [one.value for one in contracts.CalibrationStatus] == [one.value for one in CalibrationStatus]


def test_the_constants_arrive(constants, scanner):
    assert to_scanner(constants) == scanner


def test_theta_makes_the_loop(theta):
    assert to_theta(from_theta(theta)) == theta
    assert list(from_theta(theta).model_dump().values()) == list(theta.to_vector())


def test_the_source_frame_makes_the_loop_and_says_its_magnification(theta):
    frame = theta.source_frame(859.46)
    crossed = from_frame(frame)
    assert to_frame(crossed) == frame
    assert crossed.magnification == pytest.approx(frame.source_to_detector_mm / frame.source_distance_mm)


def test_bounds_arrive_and_none_stays_none():
    assert to_bounds(None) is None
    found = to_bounds(ThetaBounds(source_shift_mm=(-10.0, 20.0)))
    assert isinstance(found, Bounds)
    assert found.source_shift_mm == (-10.0, 20.0)


@pytest.mark.parametrize("name", BUILT_IN_PHANTOMS)
def test_a_drawing_makes_the_loop(name):
    drawing = BUILT_IN_PHANTOMS[name]
    assert from_phantom(to_phantom(drawing)) == drawing


def test_density_and_tolerance_make_the_loop():
    drawing = PhantomDrawing(
        name="ours",
        size_tolerance=0.004,
        shapes=[
            PolygonShape(vertices_mm=[(0, 0), (10, 0), (0, 10)], density=2.0),
            DiscShape(center_mm=(3, 3), radius_mm=1, density=-2.0),
        ],
    )
    assert from_phantom(to_phantom(drawing)) == drawing


def test_contracts_and_science_draw_the_same_built_in_phantoms():
    assert set(BUILT_IN_PHANTOMS) == set(built_in.BUILT_IN)
    for name, drawing in BUILT_IN_PHANTOMS.items():
        phantom = to_phantom(drawing)
        assert phantom.shapes == built_in.BUILT_IN[name].shapes
        assert phantom.size_tolerance == built_in.BUILT_IN[name].size_tolerance
