"""A plain fit, and adjustments to faults of the scan before the effects are fitted with the geometry."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sawmill_tomography.calibration.fit import Fit, OnStep, ignore_progress, refine
from sawmill_tomography.calibration.joint_fit.effects import Effect
from sawmill_tomography.calibration.joint_fit.sample_noise import sample_noise
from sawmill_tomography.calibration.joint_fit.selection import FITTED, chance_limit
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.statistics import noise_of_differences
from sawmill_vocabulary import Adjustment

# A fit that leaves less than this share of the sinogram, noise included, explains the scan.
WELL_EXPLAINED = 0.03


@dataclass(frozen=True, eq=False)
class KnownEffect:
    """An effect that the data's angles contain already, with the sizes (columns,) that it has there."""

    effect: Effect
    sizes: FloatArray


@dataclass(frozen=True)
class AdjustedFit:
    """A plain fit, the fitted data, and one sentence for each adjustment made."""

    phantom: Phantom  # the phantom as the scan shows it
    data: SinogramData
    fit: Fit
    from_counts: bool = False  # True if the line integrals were made from counts
    adjustments: tuple[str, ...] = ()
    known: tuple[KnownEffect, ...] = ()  # effects with which the joint fit starts
    averaging: FloatArray | None = None  # (views, cells) or None
    of_passages: bool = False  # True if the object is turned between passages, so that each view has its own pose
    on_step: OnStep = ignore_progress  # called at each step of further fits

    def after(self, data: SinogramData, fit: Fit, sentence: str) -> "AdjustedFit":
        """Return a copy with new data, a new fit and one more sentence."""
        return replace(self, data=data, fit=fit, adjustments=(*self.adjustments, sentence))

    def refitted(self, data: SinogramData, start: Fit) -> Fit | None:
        """Fit new data by least squares, starting from a fit; None where the fit does not converge."""
        fit = refine(self.phantom, data, start.frame, position_mm=start.position_mm, on_step=self.on_step)
        return fit if fit is not None and fit.converged else None

    @property
    def by_noise(self) -> "AdjustedFit":
        """The fit after a step with weights by noise, where the drawing's precision may leave as much."""
        if self.of_passages or self.fit.residual_rms > self.fit.gain * self.phantom.precision_mm:
            return self
        noise = sample_noise(self.data, self.data.sinogram - self.model, self.model)
        again = refine(
            self.phantom,
            replace(self.data, weights=noise.weights),
            self.fit.frame,
            position_mm=self.fit.position_mm,
            fixed_source_distance=bool(self.fit.covariance.held),
            max_iterations=1,
            on_step=self.on_step,
        )
        return self if again is None else replace(self, fit=again)

    @cached_property
    def model(self) -> FloatArray:
        """Model sinogram (views, cells)."""
        return self.fit.prediction(self.phantom, self.data)

    @cached_property
    def unexplained(self) -> float:
        """Share of the sinogram that the fit leaves, without white noise where the share is above `WELL_EXPLAINED`."""
        fit = self.fit
        if fit.relative_residual <= WELL_EXPLAINED:  # the share without noise is smaller still
            return fit.relative_residual
        # Neighbouring cells share the model's errors; the part that neighbouring cells do not share is noise.
        noise = noise_of_differences(np.diff(self.data.sinogram - self.model, axis=1), 1)
        total = fit.residual_rms**2 / fit.relative_residual**2
        signal = total - noise**2
        samples = self.model.size
        if samples * total <= noise**2 * chance_limit(FITTED, samples):  # white noise
            return 1.0
        return math.sqrt(max(fit.residual_rms**2 - noise**2, 0.0) / signal)


@dataclass(frozen=True)
class EffectFinding:
    """A fault of the scan or of the plain model."""

    adjustment: Adjustment  # the option that switches the adjustment off
    adjust: Callable[[AdjustedFit], AdjustedFit]  # function that searches for the fault and returns the adjusted fit
