"""Poses that change from view to view: shapes of the motion of turntable and phantom."""

import math
from collections.abc import Sequence

import numpy as np

from sawmill_tomography.calibration.joint_fit.normal_equations import Column
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel, Term
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.geometry import FloatArray


def progress(model: ScanModel) -> FloatArray:
    """Return a line from -1/2 at the first view to 1/2 at the last, (views,)."""
    return np.linspace(-0.5, 0.5, len(model.data.angles_rad))


def harmonics(model: ScanModel, order: int) -> tuple[FloatArray, FloatArray]:
    """Compute cosine and sine of a multiple of the views' angles, (views,) each."""
    angles = order * model.data.angles_rad
    return np.cos(angles), np.sin(angles)


def of_angle(shapes: Sequence[FloatArray]) -> tuple[Column, ...]:
    """Return a column for each shape (views,): the turn."""
    return tuple(Column(((Term.PSI, shape),)) for shape in shapes)


def of_position(shapes: Sequence[FloatArray]) -> tuple[Column, ...]:
    """Return two columns for each shape (views,): the phantom's position in x, and in y."""
    return tuple(Column(((term, shape),)) for shape in shapes for term in (Term.T_X, Term.T_Y))


def in_the_laboratory(model: ScanModel, shapes: Sequence[FloatArray]) -> tuple[Column, ...]:
    """Return two columns for each shape (views,): a move across the beam, and a move along the beam."""
    phi = model.data.angles_rad + model.x[FitParameter.PSI]
    cosine, sine = np.cos(phi), np.sin(phi)
    columns = []
    for shape in shapes:
        columns.append(Column(((Term.T_X, shape * cosine), (Term.T_Y, shape * sine))))
        columns.append(Column(((Term.T_X, -shape * sine), (Term.T_Y, shape * cosine))))
    return tuple(columns)


def largest_move(sizes: FloatArray) -> float:
    """Compute the amplitude, mm, of a harmonic in the laboratory from sizes (across, along) of cosine, then sine."""
    cosine, sine = np.asarray(sizes[:2]), np.asarray(sizes[2:4])
    return float(math.sqrt(max(np.linalg.eigvalsh(np.outer(cosine, cosine) + np.outer(sine, sine)).max(), 0.0)))
