"""Which rows and views are used, and how unusable input becomes the asker's failure."""

import numpy as np
import pytest

from sawmill_calibration.failures import input_errors_translated
from sawmill_calibration.scans.scan_rows import chosen_rows, chosen_views
from sawmill_formats.errors import UnreadableScan
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.jobs import FailureKind
from sawmill_tomography.calibration.errors import CalibrationError
from sawmill_tomography.geometry.geometry import GeometryError
from sawmill_tomography.phantoms.phantom import PhantomError
from sawmill_tomography.preparing.line_integrals import CountsError


def test_rows_are_those_named_or_all():
    assert chosen_rows(None, 5) == slice(0, 5)
    assert chosen_rows("1:3", 5) == slice(1, 3)
    assert chosen_rows("4:5", 5) == slice(4, 5)
    assert chosen_rows("0:5:2", 5) == slice(0, 5, 2)


def test_rows_that_are_not_there_are_refused():
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


def test_all_views_are_used_by_default():
    assert np.array_equal(chosen_views(None, 4), [0, 1, 2, 3])
    assert np.array_equal(chosen_views(None, 6, [0, 4]), [1, 2, 3, 5])
    assert np.array_equal(chosen_views(2, 6, [0, 4]), [1, 3])
    with pytest.raises(JobFailure, match="6 of which 2 are corrupt"):
        chosen_views(5, 6, [0, 4])


def test_more_views_than_there_are_are_refused():
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
