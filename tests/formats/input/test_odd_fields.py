"""Flat and dark fields that depart from the others are left out and named; drifts and groups are not."""

import numpy as np
import pytest

from sawmill_formats.input.given_fields import without_odd_fields
from sawmill_vocabulary.reading_messages import ReadingMessage

CELLS = 200
SHADOW = np.where(np.abs(np.arange(CELLS) - 90) < 30, 0.45, 1.0)
DRIFT = np.linspace(1.0, 0.9, 10)[:, None, None]


def fields(level, seed):
    return np.random.default_rng(seed).poisson(level, (10, 2, CELLS)).astype(np.float32)


def changed(stack, numbers, factor):
    stack = stack.copy()
    stack[numbers] *= factor
    return stack


FLATS, DARKS = fields(20_000, 1), fields(150, 2)
BEAM_ON = DARKS.copy()
BEAM_ON[0] = FLATS[0]


# Flats, darks, and the numbers of those of each that are left out.
ODD = {
    "honest": (FLATS, DARKS, [], []),
    "no darks": (FLATS, None, [], []),
    "drift": (FLATS * DRIFT, DARKS, [], []),
    "before and after": (changed(FLATS, slice(5, None), 0.95), DARKS, [], []),
    "beam on": (FLATS, BEAM_ON, [], [0]),
    "phantom": (changed(FLATS, 3, SHADOW), DARKS, [3], []),
    "shutter": (changed(FLATS, [8, 9], 0.0), BEAM_ON, [8, 9], [0]),
    "half open": (changed(FLATS, 4, 0.5), None, [4], []),
}


@pytest.mark.parametrize(("flats", "darks", "odd_flats", "odd_darks"), ODD.values(), ids=ODD)
def test_odd_fields_are_left_out_and_named(flats, darks, odd_flats, odd_darks):
    kept_flats, kept_darks, remarks = without_odd_fields(flats, darks)
    assert np.array_equal(kept_flats, np.delete(flats, odd_flats, axis=0))
    assert kept_darks is None if darks is None else np.array_equal(kept_darks, np.delete(darks, odd_darks, axis=0))
    expected = {ReadingMessage.FLATS_LEFT_OUT: odd_flats, ReadingMessage.DARKS_LEFT_OUT: odd_darks}
    assert {each.message: each.values["odd"] for each in remarks} == {
        message: len(odd) for message, odd in expected.items() if odd
    }


@pytest.mark.parametrize(
    ("flats", "darks", "code"),
    [
        (changed(FLATS[:2], 1, SHADOW), DARKS, "flats-differ"),
        (FLATS[:2] * np.array([1.0, 0.1])[:, None, None], DARKS, "flats-differ"),
        (FLATS * np.linspace(1.0, 10.0, 10)[:, None, None], DARKS, "flats-differ"),
        (changed(FLATS, slice(4), SHADOW), None, "flats-differ"),
        (FLATS, BEAM_ON[:2], "darks-differ"),
    ],
)
def test_fields_of_which_it_is_not_clear_which_are_odd_are_used_with_a_remark(flats, darks, code):
    kept_flats, kept_darks, (remark,) = without_odd_fields(flats, darks)
    assert kept_flats is flats
    assert kept_darks is darks
    assert remark.message.value == code
