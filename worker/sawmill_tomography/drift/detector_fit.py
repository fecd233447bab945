"""The detector's geometry from a scan of a log: by opposite rays where the scan has them, else by pairs of views."""

from dataclasses import replace

from sawmill_tomography.drift.change import DetectorFit
from sawmill_tomography.drift.opposite_rays.conjugate_rays import conjugate_fit
from sawmill_tomography.drift.opposite_rays.full_turn import opposite_rays_pair
from sawmill_tomography.drift.view_pairs.few_views import few_view_fit
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame
from sawmill_tomography.geometry.modules import FlatDetector
from sawmill_vocabulary import Rotation


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
        deviations, across_gaps = None if deviations is None else flat.resampled(deviations), flat.across_gaps
    if opposite_rays_pair(angles_rad):
        return conjugate_fit(scanner, sinogram, angles_rad, start, rotation)
    return few_view_fit(scanner, sinogram, angles_rad, start, rotation, deviations=deviations, interpolated=across_gaps)
