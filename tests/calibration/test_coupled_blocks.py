"""Blocks of slices that help their neighbours: no seam, the same volume in any blocks, and its report."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError
from small_scanner import reconstruction_input

from sawmill_calibration.reconstruction import block_solvers
from sawmill_calibration.reconstruction.reconstruct import reconstruct_in_memory
from sawmill_contracts.reconstructions import ReconstructionOptions, ReconstructionRequest, StoredReconstructionOptions
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Scanner, Theta
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.simulate import simulate_rows

MILL = Scanner(source_to_cor_mm=859.46, num_detector_pixels=120, detector_pitch_mm=4.0)
THETA = Theta(0.7, 715.0, 40.0, 10.0, 0.05)
SIZE, FIELD_MM, VIEWS, ROWS = 32, 240.0, 20, 24


def log(row):
    return Phantom("log", (Disc((5.0, -4.0), 90.0, 0.018), Disc((15.0, 30.0 - 2.0 * row), 20.0, 0.012)))


@pytest.fixture(scope="module")
def given():
    fan = FanBeamGeometry(MILL, THETA, (np.arange(VIEWS) + 0.5) * TAU / VIEWS)
    return reconstruction_input(simulate_rows([log(row) for row in range(ROWS)], fan, noise=0.04, seed=2601), fan)


def made(given, **options):
    asked = ReconstructionOptions(size=SIZE, field_mm=FIELD_MM, method="total_variation", metal="none", **options)
    return reconstruct_in_memory(given, given.geometry, asked, lambda _: None)


@pytest.fixture
def blocks_of_eight(monkeypatch):
    """Blocks of eight slices, and two beside them on either side, where memory would hold more."""
    return lambda: monkeypatch.setattr(block_solvers, "COUPLED_TOGETHER", 12)


def test_no_seam_shows_where_blocks_meet(given, blocks_of_eight):
    whole = made(given, weight=150.0, coupling="0.5")
    blocks_of_eight()
    in_blocks = made(given, weight=150.0, coupling="0.5")
    apart = np.linalg.norm(in_blocks.data - whole.data, axis=(1, 2)) / np.linalg.norm(whole.data, axis=(1, 2))
    assert apart.max() < 0.03
    steps = np.linalg.norm(np.diff(in_blocks.data, axis=0), axis=(1, 2))
    seams = np.array([7, 15])
    assert steps[seams].mean() < 1.15 * np.delete(steps, seams).mean()
    assert whole.result.method.coupling == in_blocks.result.method.coupling == 0.5
    # Each slice is counted once.
    assert (in_blocks.data.shape, in_blocks.result.method.unconverged_slices) == ((ROWS, SIZE, SIZE), 0)


def test_slices_help_each_other_where_nothing_else_is_asked_for_and_a_weight_that_is_given_stays(given):
    truth = np.stack([log(row).rasterise(SIZE, FIELD_MM) for row in range(ROWS)])
    alone, coupled = made(given, coupling="none"), made(given)
    assert alone.result.method.coupling == 0.0
    assert coupled.result.method.coupling > 0.0
    assert coupled.result.method.weight < alone.result.method.weight
    errors = [np.linalg.norm(found.data - truth) for found in (coupled, alone)]
    assert errors[0] < 0.93 * errors[1]
    report = made(given, weight=150.0).result.method
    assert report.coupling > 0.0
    assert report.weight == 150.0


def of_rows(given, rows):
    """The log with nothing in other rows."""

    def read(start, stop):
        return np.where(np.isin(np.arange(start, stop), rows)[:, None], given.read(start, stop), np.float32(0.0))

    return replace(given, read=read)


def test_all_blocks_have_one_weight_even_where_the_first_is_read_with_all_slices(given, blocks_of_eight):
    blocks_of_eight()
    # Eight slices and two beside them, then two. The middle one of those that show anything is not that of the log.
    ten = of_rows(replace(given, rows=(0, 10)), range(2, 10))
    chosen = made(ten, coupling="0.5")
    np.testing.assert_array_equal(chosen.data, made(ten, weight=chosen.result.method.weight, coupling="0.5").data)


@pytest.mark.parametrize("rows", [(), (0, 2, 22), (11, 13)])
def test_slices_that_have_no_neighbours_are_by_themselves(given, rows):
    apart, alone = (made(of_rows(given, rows), weight=150.0, coupling=coupling) for coupling in ("auto", "none"))
    np.testing.assert_allclose(apart.data, alone.data, atol=1e-6)
    assert apart.data.any(axis=(1, 2)).tolist() == [row in rows for row in range(ROWS)]
    assert not apart.result.method.coupling


def test_an_empty_slice_separates_those_beside_it(given):
    broken = made(of_rows(given, [row for row in range(ROWS) if row != 10]), weight=150.0, coupling="0.5")
    below, above = (made(of_rows(given, rows), weight=150.0, coupling="0.5") for rows in (range(10), range(11, ROWS)))
    assert not broken.data[10].any()
    apart = below.data + above.data
    # A block has one end of its descent: the same minimum is reached to its tolerance.
    assert np.linalg.norm(broken.data[9:12] - apart[9:12]) < 0.003 * np.linalg.norm(apart[9:12])


def test_one_row_alone_is_as_without_coupling(given):
    one = replace(given, rows=(3, 4), read=lambda start, stop: given.read(3 + start, 3 + stop))
    np.testing.assert_array_equal(made(one).data, made(one, coupling="none").data)


@pytest.mark.parametrize("value", ["-0.5", "much", "1000", "nan", 100, -0.5, 1e300])
def test_other_couplings_are_refused(value):
    with pytest.raises(ValidationError, match="coupling must be auto, none, or a number from 0 to below 100"):
        ReconstructionOptions(method="total_variation", coupling=value)


@pytest.mark.parametrize(("value", "number"), [("0.4", 0.4), (0.4, 0.4), (0.1 + 0.2, 0.3), (3, 3.0)])
def test_a_number_may_come_as_a_text_or_as_itself(value, number):
    assert float(ReconstructionOptions(method="total_variation", coupling=value).coupling) == number


def test_what_was_asked_before_slices_were_coupled_is_read_as_it_was_answered():
    asked = {"scan_id": "example", "method": "total_variation"}
    assert StoredReconstructionOptions.model_validate(asked).coupling == "none"
    assert ReconstructionRequest.model_validate(asked).coupling == "auto"


@pytest.mark.parametrize("method", ["tikhonov", "cauchy_map", "fbp"])
def test_other_methods_are_not_coupled(method):
    with pytest.raises(ValidationError, match=f"coupling belongs to method ring_tv or total_variation, not {method}"):
        ReconstructionOptions(method=method, coupling="0.5")
    assert ReconstructionOptions(method=method, coupling="none").coupling == "none"
