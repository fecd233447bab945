"""Measures of an image's difference from the truth."""

import numpy as np
from numpy.typing import ArrayLike
from skimage.metrics import structural_similarity


def relative_error(image: ArrayLike, truth: ArrayLike) -> float:
    """Return ||image - truth|| / ||truth|| over all pixels."""
    reference = np.asarray(truth, np.float64)
    return float(np.linalg.norm(np.asarray(image, np.float64) - reference) / np.linalg.norm(reference))


def structural_similarity_index(image: ArrayLike, truth: ArrayLike) -> float:
    """Return SSIM (Wang et al. 2004, as scikit-image computes it) with the truth's range as the data range."""
    reference = np.asarray(truth, np.float64)
    return float(structural_similarity(np.asarray(image, np.float64), reference, data_range=float(np.ptp(reference))))
