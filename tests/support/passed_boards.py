"""Passages of a board through machines of the study `benchmarks/fixed_pairs.py`, with half as many cells."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from fixed_pairs import KINDS, PHOTONS, ROW_PITCH_MM, ROWS, body, data_of, machine, pair_ray_error, passages
from tests.support.exact_chords import Detector, slanted

from sawmill_tomography.geometry.geometry import FloatArray, SourceFrame, rotate, to_vector
from sawmill_tomography.pairs.calibrate import FoundPairs, PairsTask, calibrate_pairs
from sawmill_tomography.pairs.passages import PairData
from sawmill_tomography.pairs.ray_errors import PairRays
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM
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

    def in_space(self, fans: FloatArray, slopes: FloatArray, seed: int) -> "PassedBoard":
        """Return the board, slanted, as fans in z = o + a . x see it, rows (o, a_x, a_y); flat fields change."""
        rng, measured = np.random.default_rng(seed), []
        corners = np.array(self.drawing.shapes[0].vertices_mm)
        for one, frame, (offset_mm, *tilt) in zip(self.data, self.frames, fans, strict=True):
            points = Detector(one.cells.count, one.cells.width_mm).points(SourceFrame.from_vector(frame), 8)
            flat = np.concatenate([[[0.0, 0.0]], points.reshape(-1, 2)]) - [0.0, frame[1]]
            places = np.stack(rotate(frame[0], *flat.T), -1)
            source, *ends = np.column_stack([places, offset_mm + places @ tilt])
            rows_mm, lines = np.diff(one.heights_mm).mean() * (np.arange(4) - 1.5) / 4, np.zeros(one.lines.shape)
            for passage, group in np.ndindex(lines.shape[:2]):
                lies, slope = self.lies[passage], slopes[passage]
                for height in one.heights_mm[group] + rows_mm:
                    place = np.array(lies.place_mm) + slope * height
                    chords = slanted(corners, source, np.array(ends), place, slope, lies.roll_rad)
                    through = np.exp(-0.6 * SAPWOOD_PER_MM * chords).reshape(one.cells.count, -1).mean(axis=1)
                    lines[passage, group] -= 0.25 * np.log(through)
            across = 0.003 * rng.standard_normal((len(lines), 1, 1)) * np.linspace(-1.0, 1.0, one.cells.count)
            noise = 0.002 * np.exp(0.5 * lines) * rng.standard_normal(lines.shape)
            measured.append(replace(one, lines=lines + across + noise))
        return replace(self, data=measured)

    def of_all_rows(self) -> "PassedBoard":
        """The means over all rows, which cost a third."""
        return replace(self, data=[one.binned(1) for one in self.data])


def passed_board(kind: str, pairs: int, count: int, seed: int, *of_pairs: dict[str, Any]) -> PassedBoard:
    """Simulate passages with the physics of this kind; `of_pairs` has other fields of each pair."""
    rng = np.random.default_rng(seed)
    physics, corners_mm, slopes = KINDS[kind]
    scanner, true = machine(pairs, rng)
    fewer = {"num_detector_pixels": 384, "detector_pitch_mm": 2.4}
    each = zip(scanner.pairs, of_pairs or [dict[str, Any]()] * pairs, strict=True)
    scanner = PairedScanner(tuple(replace(pair, **fewer, **change) for pair, change in each))
    (drawing, made), lies = body(corners_mm, rng), passages(count, slopes, rng)
    about = {"rows": ROWS, "row_pitch_mm": ROW_PITCH_MM, "photons": PHOTONS, "seed": seed}
    passed = simulate_passages(made, scanner, true, lies, physics, **about)
    data = [data_of(*each) for each in zip(passed, scanner.pairs, strict=True)]
    return PassedBoard(scanner, np.array([*map(to_vector, true)]), drawing, lies, data)
