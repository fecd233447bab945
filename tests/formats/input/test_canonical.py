import numpy as np
import pytest

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.canonical import CanonicalScan
from sawmill_formats.input.contents import Projections, held


@pytest.fixture
def parts(stack, angles_deg):
    return {
        "projections": held(stack),
        "angles_rad": np.deg2rad(angles_deg),
        "counts": True,
        "flats": np.ones((2, *stack.shape[1:]), np.float32),
        "darks": None,
        "detector_pitch_mm": 1.5,
        "row_pitch_mm": None,
        "format": "npz",
        "remarks": (),
    }


def read(parts, **given):
    (block,) = CanonicalScan(**parts, **given).blocks(2**20)
    return block.samples


def test_whole_scan_is_accepted_and_kept_as_it_is(parts, stack):
    np.testing.assert_array_equal(read(parts), stack)


# (6 views, 3 rows, 8 cells): a row of all views is 192 bytes, a view 96.
@pytest.mark.parametrize(
    ("together", "window", "shape"),
    [
        ((1, 1), 2**20, (6, 3)),
        ((1, 1), 400, (6, 2)),
        ((6, 1), 0, (6, 1)),
        ((1, 3), 300, (3, 3)),
        ((2, 3), 300, (2, 3)),
        ((1, 3), 0, (1, 3)),
        ((2, 2), 150, (2, 2)),
        ((9, 9), 0, (6, 3)),
    ],
)
def test_blocks_are_whole_pieces_within_the_window_and_hold_every_sample(parts, stack, together, window, shape):
    of_file = parts["projections"]
    scan = CanonicalScan(**(parts | {"projections": Projections(of_file.shape, of_file.read, together)}))
    assert scan.block_shape(window) == shape
    out = np.full_like(stack, np.nan)
    for block in scan.blocks(window):
        assert np.isnan(out[block.views, block.rows]).all()
        out[block.views, block.rows] = block.samples
    np.testing.assert_array_equal(out, stack)


class TestMissingRows:
    def test_rows_lost_at_the_ends_are_kept_as_missing_where_allowed(self, parts, stack):
        stack[1, 0] = stack[2, -1] = np.nan
        assert np.isnan(read(parts, rows_missing=True)[1, 0]).all()

    @pytest.mark.parametrize("window", [0, 96, 192, 2**20])
    def test_in_blocks_the_same_places_are_named(self, parts, stack, window):
        of_file = parts["projections"]
        parts["projections"] = Projections(of_file.shape, of_file.read, (1, 3) if window == 96 else (6, 1))
        stack[1, 0], stack[1, 2, 4] = np.nan, np.inf
        with pytest.raises(UnreadableScan, match="view 1, row 2, cell 4 is inf"):
            list(CanonicalScan(**parts, rows_missing=True).blocks(window))
        stack[1, 2] = np.nan
        with pytest.raises(UnreadableScan, match=r"view 1, row 0 is NaN in every cell.* ask for align_rows") as refusal:
            list(CanonicalScan(**parts).blocks(window))
        assert refusal.value.code == "not-finite"
        list(CanonicalScan(**parts, rows_missing=True).blocks(window))
        stack[1, 1] = np.nan
        with pytest.raises(UnreadableScan, match="view 1 has no signal"):
            list(CanonicalScan(**parts, rows_missing=True).blocks(window))
        stack[1, ::2] = 1.0
        with pytest.raises(UnreadableScan, match="view 1 lacks row 1 between others") as refusal:
            list(CanonicalScan(**parts, rows_missing=True).blocks(window))
        assert refusal.value.code == "rows-missing"
