"""A plain fit, and adjustments to faults of the scan before the effects are fitted with the geometry."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

from sawmill_tomography.calibration.fit import Fit, OnStep, ignore_progress, refine
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection import analytic
from sawmill_vocabulary import Adjustment


@dataclass(frozen=True)
class AdjustedFit:
    """A plain fit, the fitted data, and one sentence for each adjustment made.

    Attributes
    ----------
    phantom : Phantom
        The phantom as the scan shows it.
    from_counts : bool
        True if the line integrals were made from counts.
    averaging : (views, cells) float64 or None
        Correction added to the sinogram because cells average intensities.
    on_step : callable
        Called at each step of further fits.
    """

    phantom: Phantom
    data: SinogramData
    fit: Fit
    from_counts: bool = False
    adjustments: tuple[str, ...] = ()
    averaging: FloatArray | None = None
    on_step: OnStep = ignore_progress

    def after(self, data: SinogramData, fit: Fit, sentence: str) -> "AdjustedFit":
        """Return a copy with new data, a new fit and one more sentence."""
        return replace(self, data=data, fit=fit, adjustments=(*self.adjustments, sentence))

    def refitted(self, data: SinogramData, start: Fit) -> Fit | None:
        """Fit new data by least squares, starting from a fit; None where the fit does not converge."""
        fit = refine(self.phantom, data, start.frame, position_mm=start.position_mm, on_step=self.on_step)
        return fit if fit is not None and fit.converged else None

    @cached_property
    def model(self) -> FloatArray:
        """Model sinogram (views, cells)."""
        lengths = analytic.project(
            self.phantom,
            self.data.cells,
            self.fit.frame,
            self.data.angles_rad,
            position_mm=self.fit.position_mm,
            rays_per_cell=self.data.rays_per_cell,
        )
        return self.fit.gain * lengths + self.fit.offset


@dataclass(frozen=True)
class EffectFinding:
    """A fault of the scan or of the plain model.

    Attributes
    ----------
    adjustment : Adjustment
        The option that switches the adjustment off.
    adjust : callable
        Function that searches for the fault and returns the adjusted fit; the same object where there is no evidence.
    """

    adjustment: Adjustment
    adjust: Callable[[AdjustedFit], AdjustedFit]
