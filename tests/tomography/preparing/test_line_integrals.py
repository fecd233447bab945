import math

import numpy as np
import pytest
from mill_scans import line_integrals

from sawmill_tomography.preparing.line_integrals import SATURATION, CountsError, Exposure
from sawmill_vocabulary.messages import selected
from sawmill_vocabulary.reading_messages import PreparingMessage

VIEWS, ROWS, CELLS = 4, 3, 10
DARK, AIR = 100.0, 40_000.0


def fields(number=2):
    return (np.full((number, ROWS, CELLS), level, np.float32) for level in (AIR + DARK, DARK))


def counts_of(integrals):
    return (AIR * np.exp(-integrals) + DARK).astype(np.float32)


def test_counts_become_their_line_integrals():
    integrals = np.random.default_rng(701).uniform(-0.1, 5.0, (VIEWS, ROWS, CELLS))
    counts = counts_of(integrals)
    result = line_integrals(counts, *fields())
    np.testing.assert_array_equal(counts, counts_of(integrals))
    # Counts in single precision, 4e-3 of one, over the least signal, 270.
    np.testing.assert_allclose(result.stack, integrals, atol=2e-5)
    assert result.stack.dtype == np.float32
    np.testing.assert_allclose(Exposure.of(*fields()).air_level, AIR)
    assert len(result.remarks) == 1


def test_flats_and_darks_are_averaged_and_without_darks_the_counts_are_taken_as_they_are():
    integrals = np.full((VIEWS, ROWS, CELLS), 1.5)
    flats = np.stack([np.full((ROWS, CELLS), level, np.float32) for level in (AIR + DARK - 500, AIR + DARK + 500)])
    darks = np.stack([np.full((ROWS, CELLS), level, np.float32) for level in (DARK - 20, DARK + 20)])
    np.testing.assert_allclose(line_integrals(counts_of(integrals), flats, darks).stack, 1.5, atol=1e-5)
    np.testing.assert_allclose(line_integrals(counts_of(integrals) - DARK, flats - DARK, None).stack, 1.5, atol=1e-5)


def test_each_cell_has_its_own_gain():
    gain = np.random.default_rng(702).uniform(0.5, 1.5, (ROWS, CELLS))
    counts = (gain * AIR * np.exp(-np.full((VIEWS, ROWS, CELLS), 2.0)) + DARK).astype(np.float32)
    flats = (gain * AIR + DARK).astype(np.float32)[None]
    darks = np.full((1, ROWS, CELLS), DARK, np.float32)
    np.testing.assert_allclose(line_integrals(counts, flats, darks).stack, 2.0, atol=1e-4)


def test_dead_cells_are_bridged_from_their_neighbours_and_reported():
    ramp = np.broadcast_to(np.linspace(1.0, 1.9, CELLS), (VIEWS, ROWS, CELLS))
    counts = counts_of(ramp)
    flats, darks = fields()
    for row, cell in ((0, 4), (0, 5), (1, 0), (2, CELLS - 1)):
        flats[:, row, cell] = DARK
        counts[:, row, cell] = 65_535.0
    result = line_integrals(counts, flats, darks)
    expected = ramp.copy()
    # Inside, a straight line; at an end, the nearest cell's value.
    expected[:, 1, 0] = ramp[:, 1, 1]
    expected[:, 2, CELLS - 1] = ramp[:, 2, CELLS - 2]
    np.testing.assert_allclose(result.stack, expected, atol=1e-5)
    assert PreparingMessage.DEAD_CELLS(cells=4) in result.remarks
    assert Exposure.of(flats, darks).air_level[0, 4] == 0.0


def test_starved_samples_are_cut_off_and_reported():
    counts = counts_of(np.ones((VIEWS, ROWS, CELLS)))
    counts[1, 2, 3] = DARK
    counts[2, 0, 7] = DARK - 30.0
    result = line_integrals(counts, *fields())
    assert result.stack[1, 2, 3] == pytest.approx(-math.log(1e-6), rel=1e-6)
    assert result.stack[2, 0, 7] == pytest.approx(-math.log(1e-6), rel=1e-6)
    assert PreparingMessage.NO_SIGNAL(samples=2) in result.remarks
    assert np.isfinite(result.stack).all()


@pytest.mark.parametrize("share", [0.85, 0.95])
def test_counts_without_signal_are_refused(share):
    """Such as line integrals that were declared counts: 0 to 5, below the dark field."""
    counts = counts_of(np.ones((VIEWS, ROWS, CELLS)))
    counts.reshape(-1)[: round(share * counts.size)] = 5.0
    if share < 0.9:
        assert np.isfinite(line_integrals(counts, *fields()).stack).all()
        return
    sentence = r"samples of the scan are not above the dark .* 90% may: check that the data"
    with pytest.raises(CountsError, match=sentence):
        line_integrals(counts, *fields())


def test_counts_are_overwritten_some_rows_at_a_time():
    counts = counts_of(np.random.default_rng(703).uniform(-0.1, 5.0, (VIEWS, ROWS, CELLS)))
    counts[1, 2, 3] = counts[2, 0, 7] = DARK
    flats, darks = fields()
    flats[:, 1, 4] = DARK
    whole, exposure = line_integrals(counts, flats, darks), Exposure.of(flats, darks)
    starved = sum(int(exposure.to_line_integrals(counts[:, row : row + 1], row).sum()) for row in range(ROWS))
    assert exposure.remarks(starved) == whole.remarks
    np.testing.assert_array_equal(counts, whole.stack)


def test_exchanged_flats_and_darks_and_a_row_of_dead_cells_are_refused():
    flats, darks = fields()
    sentence = "30 of 30 detector cells .* row 0, cell 0 with a mean flat of .* flats and darks were not exchanged"
    with pytest.raises(CountsError, match=sentence):
        line_integrals(counts_of(np.ones((VIEWS, ROWS, CELLS))), darks, flats)
    rows = 8
    flats = np.full((1, rows, CELLS), AIR, np.float32)
    flats[:, 5] = 0.0
    with pytest.raises(CountsError, match="every cell of detector row 5 is dead: leave the row out"):
        line_integrals(np.full((VIEWS, rows, CELLS), 1000.0, np.float32), flats, None)


def saturated(largest, air, *, gain_spread=0.03, cells=200):
    """Counts of 20 000 photons that a converter cuts off at its largest value, with ten flats."""
    rng = np.random.default_rng(703)
    level = 1.0 + gain_spread * rng.standard_normal((ROWS, cells)).clip(-3.0, 3.0)
    photons = 20_000.0 * level * np.ones((VIEWS + 10, 1, 1))
    photons[:VIEWS, :, 80:120] *= np.exp(-1.0)
    taken = np.minimum(np.rint(rng.poisson(photons) * (air * largest / 20_000.0)), largest).astype(np.float32)
    return taken[:VIEWS], taken[VIEWS:]


def said_of_saturation(result):
    return list(selected(result.remarks, *SATURATION))


@pytest.mark.parametrize("largest", [4095.0, 3000.0], ids=["12 bits", "any plateau"])
def test_few_saturated_cells_are_bridged_and_named(largest):
    # Air at 0.96 of the largest value, gains of 3 %: every tenth cell is cut off.
    result = line_integrals(*saturated(largest, 0.96), None)
    (sentence,) = said_of_saturation(result)
    assert (sentence.message, sentence.values["largest"]) == (PreparingMessage.SATURATED_FLATS_BRIDGED, largest)
    assert not list(selected(result.remarks, PreparingMessage.DEAD_CELLS))
    # In the shadow a cell cut off in its flat would be off by up to 5 %; noise is 1.2 %, and bridged cells have less.
    assert np.abs(result.stack[:, :, 85:115].mean(axis=0) - 1.0).max() < 0.03


def test_many_saturated_cells_are_named_with_their_remedy_and_a_scan_brighter_than_its_flats():
    (sentence,) = said_of_saturation(line_integrals(*saturated(4095.0, 1.05), None))
    assert sentence.message is PreparingMessage.SATURATED_FLATS
    assert "Lower the tube's current or the exposure" in sentence
    counts, _ = saturated(4095.0, 1.05)
    _, flats = saturated(4095.0, 0.8)
    (sentence,) = said_of_saturation(line_integrals(counts, flats, None))
    assert (sentence.message, sentence.values["largest"]) == (PreparingMessage.SATURATED_SAMPLES, 4095)


def test_saturated_cells_are_not_taken_for_the_dead_ones():
    counts, flats = saturated(4095.0, 0.8)
    flats[:, :, :30], flats[:, :, 120:140] = 0.0, 4095.0
    result = line_integrals(counts, flats, None)
    (sentence,) = said_of_saturation(result)
    assert sentence.message is PreparingMessage.SATURATED_FLATS
    assert PreparingMessage.DEAD_CELLS(cells=30 * ROWS) in result.remarks


@pytest.mark.parametrize(
    ("of_scan", "of_flats", "low", "high"),
    [
        (0.8, 0.8, 0.0, 0.0),
        (0.96, 0.96, 0.05, 0.2),
        (1.05, 1.05, 0.9, 1.0),
        (1.05, 0.8, 0.7, 0.8),
        (0.8, 1.05, 0.9, 1.0),
    ],
)
def test_cells_are_saturated_in_the_flats_or_in_air(of_scan, of_flats, low, high):
    """Of 200 cells 40 are in the shadow."""
    counts, flats = saturated(4095.0, of_scan)[0], saturated(4095.0, of_flats)[1]
    assert low <= line_integrals(counts, flats, None).saturated_share <= high


@pytest.mark.parametrize("air", [0.02, 0.5, 0.85])
def test_sound_flats_are_not_saturated(air):
    for largest in (255.0, 4095.0, 65_535.0):
        assert not said_of_saturation(line_integrals(*saturated(largest, air), None))
