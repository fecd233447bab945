"""The one shape of a finding: it looks at a fit's residual, and where the evidence is there it adjusts the fit."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from sawmill_worker.tomography.calibration.fit import Fit, refine
from sawmill_worker.tomography.calibration.forward_model import modelled
from sawmill_worker.tomography.calibration.scatter import Scatter, parameter_scatter
from sawmill_worker.tomography.calibration.sinogram_data import SinogramData
from sawmill_worker.tomography.geometry import FloatArray
from sawmill_worker.tomography.phantom import Phantom
from sawmill_worker.vocabulary import Adjustment


@dataclass(frozen=True)
class AdjustedFit:
    """A fit, the data and terms that it was made with, and one sentence for each adjustment made.

    Attributes
    ----------
    phantom : Phantom
        As the scan shows it.
    from_counts : bool
        Whether the line integrals were made from counts.
    """

    phantom: Phantom
    data: SinogramData
    fit: Fit
    from_counts: bool = False
    adjustments: tuple[str, ...] = ()

    def after(self, data: SinogramData, fit: Fit, sentence: str) -> "AdjustedFit":
        """With other data, fit and one more sentence."""
        return AdjustedFit(self.phantom, data, fit, self.from_counts, (*self.adjustments, sentence))

    def refitted(self, data: SinogramData, start: Fit) -> Fit | None:
        """Least squares with other data, from a fit; None where it does not converge."""
        fit = refine(self.phantom, data, start.frame, position_mm=start.position_mm)
        return fit if fit is not None and fit.converged else None

    @cached_property
    def model(self) -> FloatArray:
        """The model sinogram (views, cells)."""
        return modelled(self.phantom, self.data, self.fit)

    @cached_property
    def grams(self) -> FloatArray:
        """`analytic.gram` at the fit, with all terms: (views, 13, 13)."""
        return self.data.gram(self.phantom, self.fit.to_vector(), self.fit.hardening, extended=True)

    @cached_property
    def scatter(self) -> Scatter:
        """How the residual makes the parameters scatter."""
        return parameter_scatter(self.grams, self.data, self.fit)


@dataclass(frozen=True)
class Finding:
    """A fault of the scan or of the plain model.

    Attributes
    ----------
    adjustment : Adjustment
        What switches it off.
    adjust : callable
        Looks for it, and returns the adjusted fit; the same object where the evidence is not there.
    """

    adjustment: Adjustment
    adjust: Callable[[AdjustedFit], AdjustedFit]


@dataclass(frozen=True)
class TermFinding(Finding):
    """A linear term that the model lacks; such terms resemble each other and compete.

    Attributes
    ----------
    share : callable
        Of the residual's power that the term would explain; 0 where it is there already or not worth it.
    """

    share: Callable[[AdjustedFit], float]
