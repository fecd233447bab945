"""What the residual of the fit holds beside noise: a structure, and a change during the scan."""

from dataclasses import dataclass

import numpy as np

from sawmill_worker.tomography.calibration.faults.finding import AdjustedFit
from sawmill_worker.tomography.calibration.faults.structure import Structure, find_structure
from sawmill_worker.tomography.calibration.faults.unsteadiness import Unsteadiness, find_unsteadiness
from sawmill_worker.tomography.fit_parameters import FRAME, Parameter
from sawmill_worker.tomography.geometry import FloatArray, Scanner
from sawmill_worker.tomography.ray_error import predicted_ray_error


@dataclass(frozen=True)
class ResidualAnalysis:
    """What was found in the residual.

    Attributes
    ----------
    structure : Structure or None
        None where the residual is white noise.
    unsteadiness : Unsteadiness or None
        None where nothing changed during the scan, or the first angle is not identifiable.
    unsteadiness_ray_error_mm : float
        RMS ray error that the change causes.
    """

    structure: Structure | None = None
    unsteadiness: Unsteadiness | None = None
    unsteadiness_ray_error_mm: float = 0.0

    @property
    def frame_bias(self) -> FloatArray:
        """Bias of the geometry's five unknowns, (5,); zero where nothing changed."""
        return np.zeros(len(Parameter))[FRAME] if self.unsteadiness is None else self.unsteadiness.bias[FRAME]


def analyse_residual(found: AdjustedFit, scanner: Scanner, log_radius_mm: float) -> ResidualAnalysis:
    """Look for structure and for a change during the scan in what the fit leaves."""
    data = found.data
    residual = (data.sinogram - found.model) * (1.0 if data.weights is None else data.weights > 0.0)
    structure = find_structure(residual, found.model) if found.scatter.structured else None
    unsteadiness = None
    if found.scatter.psi_identifiable:
        unsteadiness = find_unsteadiness(found.phantom, data, found.fit, found.grams, residual, found.model)
    if unsteadiness is None:
        return ResidualAnalysis(structure)
    bias = unsteadiness.bias[FRAME]
    off = predicted_ray_error(scanner, found.fit.frame, np.outer(bias, bias), radius_mm=log_radius_mm)
    return ResidualAnalysis(structure, unsteadiness, off.rms_mm)
