"""What a scan of a log says of the detector, by opposite rays where it has them, else by pairs of views."""

from sawmill_worker.tomography.conjugate_rays import conjugate_fit, opposite_rays_pair
from sawmill_worker.tomography.drift import DetectorFit
from sawmill_worker.tomography.geometry import FloatArray, Scanner, SourceFrame
from sawmill_worker.tomography.view_pairs import view_pair_fit
from sawmill_worker.vocabulary import Rotation


def detector_fit(
    scanner: Scanner, sinogram: FloatArray, angles_rad: FloatArray, start: SourceFrame, rotation: Rotation
) -> DetectorFit:
    """As `conjugate_fit` or `view_pair_fit`; opposite rays are finer, and see how far the detector stands.

    Raises
    ------
    DriftError
        As theirs.
    """
    fit = conjugate_fit if opposite_rays_pair(angles_rad) else view_pair_fit
    return fit(scanner, sinogram, angles_rad, start, rotation)
