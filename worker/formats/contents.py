"""What one file says by itself, before it is held against what its uploader says."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class FileContents:
    """The reading of one file.

    Attributes
    ----------
    format : str
        What the file turned out to be.
    projections : (views, rows, detector) or (views, detector) float32
        As stored: counts or line integrals, which no file says reliably.
    flats, darks : like the projections, or with one dimension less where there is a single one, float32
    angles_deg : (views,) float64, degrees
    angles_unusable : str or None
        Why the angles in the file cannot be used, where it has some.
    detector_pitch_mm, row_pitch_mm : float or None
        Distance between cells and between rows.
    remarks : tuple of str
        What was done to the data, one sentence each.
    """

    format: str
    projections: NDArray[np.float32]
    flats: NDArray[np.float32] | None = None
    darks: NDArray[np.float32] | None = None
    angles_deg: NDArray[np.float64] | None = None
    angles_unusable: str | None = None
    detector_pitch_mm: float | None = None
    row_pitch_mm: float | None = None
    remarks: tuple[str, ...] = ()
