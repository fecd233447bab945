"""The task of a calibration: the phantom's scan, its narrow deep shadows, and the known constants of the scanner.

Narrow peaks are searched before anything is fitted, so that the search finds the phantom. The comparison with the
fitted model decides whether a peak is metal (`metal.py`).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.calibration.refusals import refuse_round, refuse_unusable
from sawmill_tomography.calibration.sinogram_data import (
    FEW_VIEWS,
    SinogramData,
    counted_radius_mm,
    refuse_log_beyond_source,
)
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, ThetaBounds
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.sinograms.screening import Screening, screen
from sawmill_vocabulary import Adjustment, Handedness, ObjectTurns, Rotation, TrueAxis


class PoseHypothesis(NamedTuple):
    """A hypothesis of the four: the side from which the phantom was seen, and the sense in which the scanner turns."""

    handedness: Handedness
    rotation: Rotation


@dataclass(frozen=True)
class CalibrationTask:
    """The input of a calibration."""

    scanner: Scanner
    phantom: Phantom
    sinogram: FloatArray  # (views, detector) float: line integrals in any unit: gain and background are free
    angles_rad: FloatArray  # (views,): angle of each view
    # Range in which theta is searched; None searches wherever the phantom can be seen
    bounds: ThetaBounds | None = None
    handedness: Handedness | None = None  # known handedness and rotation; None tries both
    rotation: Rotation | None = None
    rays_per_cell: int | None = None  # rays per cell in the model; None averages over the cell, as a real detector does
    # Radius of the largest log, the disc around the COR in which ray errors are measured; None takes the phantom's
    log_radius_mm: float | None = None
    tolerance_mm: float = 0.1  # the largest ray error that passes
    scale_tolerance_percent: float = 0.5  # the largest uncertainty of the scale, 95 %, that passes
    # Axis of the drawing along which the phantom's size is known to be right; None trusts both axes alike
    true_axis: TrueAxis | None = None
    # True if the line integrals were made from counts: then each cell averaged intensities, not paths
    from_counts: bool = False
    without: frozenset[Adjustment] = frozenset()  # adjustments to faults of the scan that are switched off
    # (views, cells) bool or None: samples that see metal; None where they are not known yet
    metal: NDArray[np.bool_] | None = None
    saturated_share: float = 0.0  # share of the cells that are saturated in the flat fields or in the views

    def __post_init__(self) -> None:
        """Refuse data that do not belong together, and a phantom that cannot calibrate."""
        refuse_round(self.phantom)
        sinogram = np.ascontiguousarray(self.sinogram, np.float64)
        angles = np.ascontiguousarray(self.angles_rad, np.float64)
        refuse_unusable(self.scanner, sinogram, angles)
        refuse_log_beyond_source(self.log_radius_mm, self.scanner)
        object.__setattr__(self, "sinogram", sinogram)
        object.__setattr__(self, "angles_rad", angles)

    def radius_mm(self, handedness: Handedness, position_mm: tuple[float, float]) -> float:
        """Return the radius of the disc in which ray errors are measured, with the phantom at this position."""
        return counted_radius_mm(self.log_radius_mm, self.phantoms[handedness].moved(*position_mm))

    @cached_property
    def phantoms(self) -> dict[Handedness, Phantom]:
        """The phantom as seen by each allowed handedness."""
        seen = {Handedness.AS_DRAWN: self.phantom, Handedness.FROM_BEHIND: self.phantom.mirrored()}
        return {h: p for h, p in seen.items() if self.handedness in {None, h}}

    @property
    def of_passages(self) -> bool:
        """True if the object is turned between passages, and has another pose in each view."""
        return self.scanner.object_turns is ObjectTurns.BETWEEN_PASSAGES and Adjustment.VIEW_POSES not in self.without

    @property
    def rotations(self) -> tuple[Rotation, ...]:
        """The allowed senses of rotation."""
        return tuple(r for r in Rotation if self.rotation in {None, r})

    @cached_property
    def screening(self) -> Screening:
        """Cells, views and samples that have a usable signal of the phantom."""
        usable = screen(
            self.sinogram,
            cells=Adjustment.FAULTY_CELLS not in self.without,
            views=Adjustment.CORRUPT_VIEWS not in self.without,
        )
        hidden = self.metal
        if hidden is None and Adjustment.METAL not in self.without:
            hidden = narrow_peaks(usable.bridged(self.sinogram), usable.views, self.scanner.detector_pitch_mm)
        return usable if hidden is None else replace(usable, hidden=hidden)

    def full_data(self, rotation: Rotation) -> SinogramData:
        """Return all views and cells in this sense of rotation; samples without a usable signal have weight 0."""
        cells = DetectorCells.of(self.scanner)
        angles = rotation.apply(self.angles_rad)
        return SinogramData(self.sinogram, angles, cells, self.rays_per_cell, self.screening.weights)


# A peak is narrow when it exceeds the samples at this distance on the detector, on both sides.
WIDTH_MM = 12.0
# A peak is deep where the mean of three cells exceeds these samples by this share of the phantom's depth: in some scans
# of 2 000 photons and more the corners of sound phantoms reached 0.09 in one view of ten, screws of 5 mm 0.2 in half of
# the views.
DEEP = 0.15
# Quantiles of the sinogram without its peaks, between which the phantom's depth lies.
QUANTILES = (0.02, 0.99)


def narrow_peaks(sinogram: FloatArray, views: NDArray[np.bool_], pitch_mm: float) -> NDArray[np.bool_] | None:
    """Find samples (views, cells) of narrow deep shadows with their surroundings; None where there are none.

    `sinogram` (views, cells): line integrals in any unit. `views` (views,) bool: usable views.
    """
    width = max(2, round(WIDTH_MM / pitch_mm))
    if sinogram.shape[1] <= 4 * width:
        return None
    # By how much samples exceed the samples `width` cells to either side.
    excess = sinogram[:, width:-width] - np.maximum(sinogram[:, : -2 * width], sinogram[:, 2 * width :])
    low, high = np.quantile(sinogram[:, width:-width] - np.maximum(excess, 0.0), QUANTILES)
    deep = (excess[:, :-2] + excess[:, 1:-1] + excess[:, 2:]) > 3.0 * DEEP * (high - low)
    if not high > low or deep[views].any(axis=1).mean() < FEW_VIEWS:  # noise in the deepest shadow
        return None
    peaks = np.zeros(sinogram.shape, np.uint8)
    peaks[:, width + 1 : -width - 1] = deep
    return np.asarray(scipy.ndimage.maximum_filter1d(peaks, width, axis=1, mode="constant") > 0)
