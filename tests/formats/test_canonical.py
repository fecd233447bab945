import numpy as np
import pytest

from worker.formats.canonical import CanonicalScan
from worker.formats.errors import UnreadableScan


@pytest.fixture
def parts(stack, angles_deg):
    return {
        "projections": stack,
        "angles_rad": np.deg2rad(angles_deg),
        "counts": True,
        "flats": np.ones((2, *stack.shape[1:]), np.float32),
        "darks": None,
        "detector_pitch_mm": 1.5,
        "row_pitch_mm": None,
        "format": "npz",
        "remarks": (),
    }


def test_whole_scan_is_accepted_and_kept_as_it_is(parts):
    scan = CanonicalScan(**parts)
    assert scan.projections is parts["projections"]


@pytest.mark.parametrize(
    ("name", "change", "code", "sentence"),
    [
        ("projections", lambda a: a[:, 0], "wrong-shape", r"must be \(views, rows, detector\)"),
        ("angles_rad", lambda a: a[:-1], "angles-mismatch", "5 angles for 6 views"),
        ("angles_rad", lambda a: a * np.nan, "not-finite", "the angle of view 0 is nan"),
        ("angles_rad", lambda a: a * 0, "angles-repeated", "views 0 and 1"),
        ("flats", lambda _: None, "flats-missing", "at least one flat field"),
        ("flats", lambda a: a[:0], "wrong-shape", "flat fields have the shape"),
        ("flats", lambda a: a * np.inf, "not-finite", "flat 0, row 0, cell 0 is inf"),
        ("counts", lambda _: False, "contradiction", "declared line integrals"),
    ],
)
def test_each_disagreement_has_its_sentence(parts, name, change, code, sentence):
    with pytest.raises(UnreadableScan, match=sentence) as refusal:
        CanonicalScan(**(parts | {name: change(parts[name])}))
    assert refusal.value.code == code


class TestMissingRows:
    def test_rows_lost_at_the_ends_are_kept_as_missing_where_allowed(self, parts):
        parts["projections"][1, 0] = parts["projections"][2, -1] = np.nan
        scan = CanonicalScan(**parts, rows_missing=True)
        assert np.isnan(scan.projections[1, 0]).all()

    def test_elsewhere_they_are_refused_with_the_cure(self, parts):
        parts["projections"][1, 0] = np.nan
        with pytest.raises(UnreadableScan, match=r"view 1, row 0 is NaN in every .* ask for align_rows") as refusal:
            CanonicalScan(**parts)
        assert refusal.value.code == "not-finite"

    def test_a_gap_is_no_loss_at_an_end(self, parts):
        parts["projections"][1, 1] = np.nan
        with pytest.raises(UnreadableScan, match="view 1 lacks row 1 between others") as refusal:
            CanonicalScan(**parts, rows_missing=True)
        assert refusal.value.code == "rows-missing"

    def test_a_single_value_is_still_named_by_its_place(self, parts):
        parts["projections"][1, 0] = np.nan
        parts["projections"][1, 2, 4] = np.inf
        with pytest.raises(UnreadableScan, match="view 1, row 2, cell 4 is inf"):
            CanonicalScan(**parts, rows_missing=True)

    def test_a_view_of_nothing_is_refused(self, parts):
        parts["projections"][1] = np.nan
        with pytest.raises(UnreadableScan, match="view 1 is NaN throughout"):
            CanonicalScan(**parts, rows_missing=True)
