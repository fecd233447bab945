"""What is asked of a calibration: the scan of the phantom, and what is known of the scanner."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.faults.narrow_peaks import narrow_peaks
from sawmill_tomography.calibration.faults.screening import Screening, screen
from sawmill_tomography.calibration.refusals import refuse_round, refuse_unusable
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, ThetaBounds
from sawmill_tomography.geometry.log_radius import counted_radius_mm, refuse_log_beyond_source
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import Adjustment, Handedness, Rotation, TrueAxis


class PoseHypothesis(NamedTuple):
    """One of the four: from which side the phantom was seen, and in which sense the scanner turns."""

    handedness: Handedness
    rotation: Rotation


@dataclass(frozen=True)
class CalibrationTask:
    """What is asked.

    Attributes
    ----------
    sinogram : (views, detector) float
        Line integrals in any unit: gain and background are free.
    angles_rad : (views,) float64
        Every view's own angle.
    bounds : ThetaBounds or None
        Where theta is searched; None searches wherever the phantom can be seen.
    handedness, rotation
        None tries both.
    rays_per_cell : int or None
        Rays per cell in the model; None averages over the cell, as a real detector does.
    log_radius_mm : float or None
        Radius of the largest log, the disc around the COR in which ray errors are measured; None takes the phantom's.
    tolerance_mm : float
        The largest ray error that passes.
    scale_tolerance_percent : float
        The largest uncertainty of the scale, 95 %, that passes.
    true_axis : "x" or "y", or None
        Along which axis of its drawing the phantom's size is known to be right; None: along either as well.
    from_counts : bool
        Whether the line integrals were made from counts: then each cell averaged intensities, not paths.
    without : frozenset of Adjustment
        Which adjustments to faults of the scan are switched off.
    metal : (views, cells) bool or None
        Samples that see metal; None where that is not known yet.
    """

    scanner: Scanner
    phantom: Phantom
    sinogram: FloatArray
    angles_rad: FloatArray
    bounds: ThetaBounds | None = None
    handedness: Handedness | None = None
    rotation: Rotation | None = None
    rays_per_cell: int | None = None
    log_radius_mm: float | None = None
    tolerance_mm: float = 0.1
    scale_tolerance_percent: float = 0.5
    true_axis: TrueAxis | None = None
    from_counts: bool = False
    without: frozenset[Adjustment] = frozenset()
    metal: NDArray[np.bool_] | None = None

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
        """Of the disc in which ray errors are measured, with the phantom as it was found."""
        return counted_radius_mm(self.log_radius_mm, self.phantoms[handedness].moved(*position_mm))

    @cached_property
    def phantoms(self) -> dict[Handedness, Phantom]:
        """The phantom as each allowed handedness sees it."""
        seen = {Handedness.AS_DRAWN: self.phantom, Handedness.FROM_BEHIND: self.phantom.mirrored()}
        return {h: p for h, p in seen.items() if self.handedness in {None, h}}

    @property
    def rotations(self) -> tuple[Rotation, ...]:
        """The allowed senses of rotation."""
        return tuple(r for r in Rotation if self.rotation in {None, r})

    @cached_property
    def screening(self) -> Screening:
        """Which cells, views and samples have a usable signal of the phantom."""
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
        """All views and cells, as this sense of rotation reads them; what has no usable signal has weight 0."""
        cells = DetectorCells.of(self.scanner)
        angles = rotation.apply(self.angles_rad)
        return SinogramData(self.sinogram, angles, cells, self.rays_per_cell, self.screening.weights)
