"""Passages of a board through machines of the study `benchmarks/fixed_pairs.py`, with half as many cells."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from fixed_pairs import KINDS, PHOTONS, ROW_PITCH_MM, ROWS, body, data_of, machine, passages

from sawmill_tomography.geometry.geometry import FloatArray, to_vector
from sawmill_tomography.pairs.calibrate import FoundPairs, PairsTask, calibrate_pairs
from sawmill_tomography.pairs.passages import PairData
from sawmill_tomography.pairs.ray_errors import PairRays, pair_ray_error
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.physics.passages import Passage, simulate_passages
from sawmill_vocabulary import PairedScanner


@dataclass(frozen=True)
class PassedBoard:
    """What a machine measures of a board, and the truth."""

    scanner: PairedScanner
    frames: FloatArray  # (pairs, 5), the true ones
    drawing: Phantom
    lies: Sequence[Passage]
    data: Sequence[PairData]

    def calibrated(self, *, mirrored: bool = False, **of_pairs: Any) -> tuple[FoundPairs, float]:
        """Calibrate with these fields of all pairs; return the answer and the error of its rays, RMS, mm."""
        scanner = PairedScanner(tuple(replace(pair, **of_pairs) for pair in self.scanner.pairs))
        found = calibrate_pairs(PairsTask(scanner, self.drawing.mirrored() if mirrored else self.drawing, self.data))
        rays = PairRays([pair.scanner for pair in scanner.pairs], self.frames, found.radius_mm)
        return found, pair_ray_error(rays, np.array([to_vector(pair.frame) for pair in found.pairs])).rms_mm

    def of_all_rows(self) -> "PassedBoard":
        """The means over all rows, which cost a third."""
        return replace(self, data=[one.binned(1) for one in self.data])


def passed_board(kind: str, pairs: int, count: int, seed: int, *of_pairs: dict[str, Any]) -> PassedBoard:
    """Simulate passages with the physics of this kind; `of_pairs` has other fields of each pair."""
    rng = np.random.default_rng(seed)
    physics, corners_mm, slopes = KINDS[kind]
    scanner, true = machine(pairs, rng)
    changes = of_pairs or [dict[str, Any]()] * pairs
    fewer = {"num_detector_pixels": 384, "detector_pitch_mm": 2.4}
    changed = [replace(pair, **fewer, **change) for pair, change in zip(scanner.pairs, changes, strict=True)]
    scanner = PairedScanner(tuple(changed))
    (drawing, made), lies = body(corners_mm, rng), passages(count, slopes, rng)
    about = {"rows": ROWS, "row_pitch_mm": ROW_PITCH_MM, "photons": PHOTONS, "seed": seed}
    passed = simulate_passages(made, scanner, true, lies, physics, **about)
    data = [data_of(*each) for each in zip(passed, scanner.pairs, strict=True)]
    return PassedBoard(scanner, np.array([*map(to_vector, true)]), drawing, lies, data)
