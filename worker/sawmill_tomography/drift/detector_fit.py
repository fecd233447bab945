"""The detector's geometry from a scan of a log: by opposite rays where the scan has them, else by pairs of views."""

from dataclasses import replace
from functools import partial

import numpy as np

from sawmill_tomography.drift.change import DetectorFit, DriftError
from sawmill_tomography.drift.opposite_rays.conjugate_rays import conjugate_fit
from sawmill_tomography.drift.opposite_rays.full_turn import opposite_rays_pair
from sawmill_tomography.drift.view_pairs.few_views import few_view_fit
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame
from sawmill_tomography.geometry.modules import FlatDetector
from sawmill_vocabulary import Rotation

# Where opposite rays leave u_c uncertain by more than this share of a cell, motions during the scan disturb them: pairs
# of views fit those (benchmarks/production_logs.py: 360 views with slides or wrong turns).
UNCERTAIN_CELLS = 0.01


def detector_fit(
    scanner: Scanner,
    sinogram: FloatArray,
    angles_rad: FloatArray,
    start: SourceFrame,
    rotation: Rotation,
    *,
    deviations: FloatArray | None = None,
) -> DetectorFit:
    """Fit the detector's geometry by `conjugate_fit`, which is finer and sees SDD, or else by `few_view_fit`.

    Where both answer, and the first is uncertain, the more certain u_c counts.

    Parameters
    ----------
    deviations : (views, detector) float64, optional
        Parameter of `few_view_fit`. Opposite rays need none: their errors follow from the rays' differences.

    Raises
    ------
    DriftError
        Error of `conjugate_fit` or `few_view_fit`.
    GeometryError
        Error of `few_view_fit`.
    """
    across_gaps = None
    if scanner.detector_modules:
        # Opposite rays are interpolated between cells at equal distances.
        flat = FlatDetector.of(scanner, start)
        sinogram, scanner = flat.resampled(sinogram), replace(scanner, detector_modules=())
        across_gaps = flat.across_gaps
        if deviations is not None:
            # Where they jump, a cubic overshoots: below 0 they would be no deviations.
            nearest = np.minimum(*(deviations[..., cells] for cells in flat.cells[1:3]))
            deviations = np.maximum(flat.resampled(deviations), nearest)
    of_pairs = partial(
        few_view_fit, scanner, sinogram, angles_rad, start, rotation, deviations=deviations, interpolated=across_gaps
    )
    if not opposite_rays_pair(angles_rad):
        return of_pairs()
    by_opposite = conjugate_fit(scanner, sinogram, angles_rad, start, rotation)
    if by_opposite.deviation[0] <= UNCERTAIN_CELLS * scanner.detector_pitch_mm:
        return by_opposite
    try:
        by_pairs = of_pairs()
    except DriftError:
        # What pairs of views cannot answer, opposite rays have answered with their larger uncertainty.
        return by_opposite
    more_certain = by_pairs.deviation[0] < by_opposite.deviation[0]
    return replace(by_pairs, movement=by_opposite.movement) if more_certain else by_opposite
