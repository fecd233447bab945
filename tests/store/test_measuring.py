"""A stored phantom is measured anew."""

import pytest

from sawmill_contracts.phantoms import MeasurementsAsk, PhantomDrawing, PhantomPicture, SizeMeasurement
from sawmill_platform.errors import Conflict, Invalid
from sawmill_vocabulary import STANDARD_SIZE_TOLERANCE, Disc, Polygon

BOARD = Polygon(((-100.0, -150.0), (100.0, -150.0), (100.0, 150.0), (-100.0, 150.0)))
HOLE = Disc((-50.0, 0.0), 20.0, -1.0)


def length(what: str, measured_mm: float, **others: object) -> SizeMeasurement:
    return SizeMeasurement(what=what, measured_mm=measured_mm, standard_uncertainty_mm=0.1, **others)


def rms(first: float, second: float) -> float:
    return ((first**2 + second**2) / 2) ** 0.5


@pytest.fixture
def board(store):
    drawing = PhantomDrawing(name="board", shapes=[BOARD, HOLE], measurements=[length("diagonal", 360.0)])
    return store.phantoms.create(drawing)


def test_the_shapes_are_stretched_to_what_was_measured_and_the_old_phantom_stays(store, board):
    ask = MeasurementsAsk(measurements=[length("x", 198.0), length("y", 303.0)])
    newer = store.phantoms.measure(board.id, ask)
    assert newer.drawing.extent_mm == pytest.approx((198.0, 303.0))
    disc = newer.drawing.shapes[1]
    assert disc.center_mm == pytest.approx((-49.5, 0.0))
    # The geometric mean of 0.99 and 1.01, to the tenth of a micrometre at which shapes are kept.
    assert disc.radius_mm == pytest.approx(20.0 * (0.99 * 1.01) ** 0.5, abs=1e-4)
    assert newer.drawing.follows == board.id
    assert store.phantoms.get(board.id) == board
    assert store.phantoms.followers() == {board.id: newer.id}


def test_a_length_replaces_the_earlier_one_of_its_name_and_the_size_tolerance_follows(store, board):
    first = store.phantoms.measure(board.id, MeasurementsAsk(measurements=[length("x", 199.0)], stretch_drawing=False))
    again = store.phantoms.measure(first.id, MeasurementsAsk(measurements=[length("x", 199.5)]))
    assert [(each.what, each.measured_mm) for each in again.drawing.measurements] == [("diagonal", 360.0), ("x", 199.5)]
    assert first.drawing.extent_mm == (200.0, 300.0)
    assert again.drawing.extent_mm == pytest.approx((199.5, 300.0))
    # The RMS over both sides: y is as it was drawn, and the drawing states no tolerance of its own.
    assert again.drawing.size_tolerance == pytest.approx(rms(STANDARD_SIZE_TOLERANCE, 0.1 / 199.5))
    both = store.phantoms.measure(again.id, MeasurementsAsk(measurements=[length("y", 300.0)]))
    assert both.drawing.size_tolerance == pytest.approx(
        (((0.1 / 360) ** 2 + (0.1 / 199.5) ** 2 + (0.1 / 300) ** 2) / 3) ** 0.5
    )


def test_a_side_that_was_not_measured_keeps_the_tolerance_that_its_drawing_states(store):
    first = store.phantoms.create(PhantomDrawing(name="board", shapes=[BOARD], size_tolerance=0.004))
    for measured_mm in (199.0, 199.5, 200.0):
        first = store.phantoms.measure(first.id, MeasurementsAsk(measurements=[length("x", measured_mm)]))
        assert first.drawing.size_tolerance == pytest.approx(rms(0.004, 0.1 / measured_mm))


def test_the_true_axis_alone_is_enough(store):
    board = store.phantoms.create(PhantomDrawing(name="board", shapes=[BOARD], true_axis="x"))
    newer = store.phantoms.measure(board.id, MeasurementsAsk(measurements=[length("x", 200.0)]))
    assert newer.drawing.size_tolerance == pytest.approx(0.1 / 200)


def test_a_length_that_is_another_phantom_s_is_refused(store, board):
    with pytest.raises(Invalid, match=r"x was measured as 20 mm and is drawn 200 mm long: give a length within 10%"):
        store.phantoms.measure(board.id, MeasurementsAsk(measurements=[length("x", 20.0)]))


def test_a_picture_that_is_being_traced_cannot_be_measured(store):
    received = store.files.receive([b"picture"], max_bytes=10)
    traced = store.phantoms.accept_picture(PhantomPicture(name="cross", width_mm=400.0), received)
    with pytest.raises(Conflict, match="is tracing and has no drawing to measure"):
        store.phantoms.measure(traced.id, MeasurementsAsk(measurements=[length("x", 20.0)]))
