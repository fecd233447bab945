"""What a scan of a log says of the detector, by opposite rays where it has them, else by pairs of views."""

from sawmill_tomography.drift.change import DetectorFit
from sawmill_tomography.drift.opposite_rays.conjugate_rays import conjugate_fit
from sawmill_tomography.drift.opposite_rays.full_turn import opposite_rays_pair
from sawmill_tomography.drift.view_pairs.few_views import few_view_fit
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame
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
    """As `conjugate_fit` or `few_view_fit`; opposite rays are finer, and see how far the detector stands.

    Parameters
    ----------
    deviations : (views, detector) float64, optional
        As of `few_view_fit`. Opposite rays need none: their errors follow from how the rays differ.

    Raises
    ------
    DriftError
        As theirs.
    GeometryError
        As of `few_view_fit`.
    """
    if opposite_rays_pair(angles_rad):
        return conjugate_fit(scanner, sinogram, angles_rad, start, rotation)
    return few_view_fit(scanner, sinogram, angles_rad, start, rotation, deviations=deviations)
