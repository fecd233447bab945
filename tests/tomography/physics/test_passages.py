"""Passages through fixed pairs, against exact chords of rays."""

import math

import numpy as np
import pytest
from tests.support.exact_chords import Detector, scan

from sawmill_tomography.geometry.geometry import SourceFrame
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.phantom import Polygon
from sawmill_tomography.physics.passages import FIELDS, Passage, simulate_passages
from sawmill_vocabulary import CellOrder, FixedPair, PairedScanner

PER_MM, PHOTONS, SAME, ROW_PITCH_MM = 0.01, 30_000.0, 40, 25.0
BOARD = L_SHAPE.of_density(PER_MM)
PAIRS = PairedScanner(
    (
        FixedPair(20.0, 860.0, 1570.0, 384, 2.4, cell_order=CellOrder.COUNTER_CLOCKWISE, feed_offset_mm=-60.0),
        FixedPair(110.0, 800.0, 1500.0, 384, 2.4, cell_order=CellOrder.CLOCKWISE, feed_offset_mm=140.0),
    )
)
FRAMES = [SourceFrame(0.4, 871.0, 1560.0, 14.0, 0.05), SourceFrame(1.9, 790.0, 1512.0, -9.0, -0.03)]
LIES = Passage((14.0, -9.0), 2.2, (0.05, -0.04), 1e-3)


def lying(height_mm: float) -> list[Polygon]:
    """The board's corners in the hall at a height: rolled about its own origin, then moved."""
    roll = LIES.roll_rad + height_mm * LIES.twist_rad_per_mm
    place = np.array(LIES.place_mm) + height_mm * np.array(LIES.slope)
    turn = np.array([[math.cos(roll), -math.sin(roll)], [math.sin(roll), math.cos(roll)]])
    corners = [np.array(shape.vertices_mm) @ turn.T + place for shape in BOARD.shapes]
    return [Polygon(tuple(map(tuple, own)), PER_MM) for own in corners]


def test_counts_are_the_exact_transmissions_of_the_board_in_the_hall_but_for_noise():
    about = {"rows": 3, "row_pitch_mm": ROW_PITCH_MM, "photons": PHOTONS, "seed": 5}
    passed = simulate_passages(BOARD, PAIRS, FRAMES, [LIES] * SAME, **about)
    for one, pair, frame in zip(passed, PAIRS.pairs, FRAMES, strict=True):
        dark, detector = one.darks.mean(axis=0), Detector(pair.num_detector_pixels, pair.detector_pitch_mm)
        measured = (one.counts.mean(axis=0) - dark) / (one.flats.mean(axis=0) - dark)
        heights = ROW_PITCH_MM * np.array([-1.0, 0.0, 1.0]) + pair.feed_offset_mm
        way = 1 if pair.cell_order is CellOrder.CLOCKWISE else -1
        expected = np.array([scan(lying(at), detector, frame, np.zeros(1))[0, ::way] for at in heights])
        deviations = np.sqrt((expected / SAME + expected**2 / FIELDS) / PHOTONS)
        off, turned = (measured - expected) / deviations, (expected[0] - expected[2]) / deviations[0]
        assert np.sqrt(np.mean(off**2)) == pytest.approx(1.0, abs=0.1)
        assert np.abs(off).max() < 5.0 < np.sqrt(np.mean(turned**2))  # the third row is not the first
