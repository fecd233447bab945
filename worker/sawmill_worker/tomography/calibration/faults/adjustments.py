"""The faults that a calibration adjusts for, in their order; nothing is done where nothing is wrong.

Outliers and inconsistent views lose their weight. Blur, beam hardening, a density that slopes over the wood, and a gain
or background of each view become terms of the model. A term must lower the residual by far more than chance, and by a
share that matters, before it is taken in.
"""

from collections.abc import Collection

from sawmill_worker.tomography.calibration.faults.beam_hardening import BEAM_HARDENING
from sawmill_worker.tomography.calibration.faults.blur import BLUR
from sawmill_worker.tomography.calibration.faults.density_gradient import DENSITY_GRADIENT
from sawmill_worker.tomography.calibration.faults.finding import AdjustedFit, Finding
from sawmill_worker.tomography.calibration.faults.inconsistent_views import INCONSISTENT_VIEWS
from sawmill_worker.tomography.calibration.faults.intensity_averaging import INTENSITY_AVERAGING
from sawmill_worker.tomography.calibration.faults.linear_terms import take_terms
from sawmill_worker.tomography.calibration.faults.outliers import OUTLIERS
from sawmill_worker.tomography.calibration.faults.view_gain import VIEW_GAIN
from sawmill_worker.vocabulary import Adjustment

# Terms compete with each other; what is before them and after them is looked for one by one. A blur that was found
# sets free what the terms could not explain of a sharp model: they are looked for again.
BEFORE_TERMS: tuple[Finding, ...] = (INTENSITY_AVERAGING, OUTLIERS)
TERMS = (VIEW_GAIN, BEAM_HARDENING, DENSITY_GRADIENT)
AFTER_TERMS: tuple[Finding, ...] = (INCONSISTENT_VIEWS, BLUR)


def adjust(now: AdjustedFit, without: Collection[Adjustment] = ()) -> AdjustedFit:
    """Go from the plain fit to the one that the scan's faults ask for; those in `without` are not looked for."""
    terms = [term for term in TERMS if term.adjustment not in without]
    now = take_terms(_each(BEFORE_TERMS, now, without), terms)
    after = _each(AFTER_TERMS, now, without)
    return take_terms(after, terms) if after.data.blur_cells > 0.0 else after


def _each(findings: Collection[Finding], now: AdjustedFit, without: Collection[Adjustment]) -> AdjustedFit:
    for finding in findings:
        if finding.adjustment not in without:
            now = finding.adjust(now)
    return now
