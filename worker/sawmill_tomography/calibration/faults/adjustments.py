"""The faults of a scan: what is done before the fit, and the effects that every scan is tested for."""

from collections.abc import Collection

from sawmill_tomography.calibration.faults.beam_hardening import BEAM_HARDENING
from sawmill_tomography.calibration.faults.blur import BLUR
from sawmill_tomography.calibration.faults.corners import CORNERS
from sawmill_tomography.calibration.faults.creep import CREEP
from sawmill_tomography.calibration.faults.deformation import DEFORMATION
from sawmill_tomography.calibration.faults.density_gradient import DENSITY_GRADIENT
from sawmill_tomography.calibration.faults.effect import Effect
from sawmill_tomography.calibration.faults.encoder import ENCODER
from sawmill_tomography.calibration.faults.finding import AdjustedFit, EffectFinding
from sawmill_tomography.calibration.faults.flat_field import FLAT_FIELD
from sawmill_tomography.calibration.faults.intensity_averaging import INTENSITY_AVERAGING
from sawmill_tomography.calibration.faults.lag import LAG
from sawmill_tomography.calibration.faults.outliers import OUTLIERS
from sawmill_tomography.calibration.faults.pace import PACE
from sawmill_tomography.calibration.faults.rotation_during_exposure import ROTATION_DURING_EXPOSURE
from sawmill_tomography.calibration.faults.scattered_radiation import SCATTERED_RADIATION
from sawmill_tomography.calibration.faults.wobble import WOBBLE_ONCE, WOBBLE_TWICE
from sawmill_vocabulary import Adjustment

BEFORE: tuple[EffectFinding, ...] = (INTENSITY_AVERAGING, OUTLIERS)
EFFECTS: tuple[Effect, ...] = (
    BEAM_HARDENING,
    SCATTERED_RADIATION,
    BLUR,
    LAG,
    ROTATION_DURING_EXPOSURE,
    FLAT_FIELD,
    DENSITY_GRADIENT,
    DEFORMATION,
    CORNERS,
    PACE,
    CREEP,
    ENCODER,
    WOBBLE_ONCE,
    WOBBLE_TWICE,
)
# A body that comes nearer to the source twice a turn casts the shadow of one that is longer in one direction, but for
# the lengths of the rays in it, which a gain of each view hides.
ALIKE = (DEFORMATION, WOBBLE_TWICE)


def prepare(now: AdjustedFit, without: Collection[Adjustment] = ()) -> AdjustedFit:
    """Go from the plain fit to the one that effects are fitted from; faults in `without` are not looked for."""
    for finding in BEFORE:
        if finding.adjustment not in without:
            now = finding.adjust(now)
    return now
