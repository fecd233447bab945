"""Priors of effects, for calibrations and drift checks: each is there with odds, normal with a log-uniform size."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment

# Number of sizes, log-uniform between an effect's lowest and highest.
SIZES = 8


@dataclass(frozen=True)
class Prior:
    """What is expected of an effect: its odds, and its sizes where it is there, in the units of its columns."""

    low: float
    high: float
    odds: float = 0.1

    @cached_property
    def sizes(self) -> FloatArray:
        """Sizes (SIZES,) in its range, of which each is the one before times a factor."""
        return np.geomspace(self.low, self.high, SIZES)

    def in_units(self, unit: float) -> "Prior":
        """Return the prior with its sizes divided by a unit."""
        return Prior(self.low / unit, self.high / unit, self.odds)


# Units: shares of the longest path's line integral, of the intensity, of the size or of the density; cells^2; mm^2; mm
# at the phantom's rim; mm on the detector.
PRIORS: dict[Adjustment, Prior] = {
    Adjustment.BEAM_HARDENING: Prior(0.003, 0.5),
    Adjustment.SCATTERED_RADIATION: Prior(0.001, 0.2),
    Adjustment.BLUR: Prior(0.03, 3.0),
    Adjustment.LAG: Prior(0.001, 0.06),
    Adjustment.ROTATION_DURING_EXPOSURE: Prior(0.03, 1.0),
    Adjustment.FLAT_FIELD: Prior(0.001, 0.05),
    Adjustment.DENSITY_GRADIENT: Prior(0.003, 0.15),
    Adjustment.DEFORMATION: Prior(0.0003, 0.01),
    Adjustment.CORNERS: Prior(0.3, 60.0),
    Adjustment.PACE: Prior(0.02, 2.0),
    Adjustment.CREEP: Prior(0.02, 0.6),
    Adjustment.ENCODER: Prior(0.02, 1.0),
    Adjustment.WOBBLE: Prior(0.02, 0.6),
    Adjustment.SLIP: Prior(0.02, 0.6),
    Adjustment.BOW: Prior(0.03, 1.5),
    Adjustment.SURFACE_DENSITY: Prior(0.01, 0.4),
    Adjustment.MODULES: Prior(0.05, 5.0, odds=0.01),
    Adjustment.CELL_PLACES: Prior(0.05, 5.0, odds=1e-4),
}
