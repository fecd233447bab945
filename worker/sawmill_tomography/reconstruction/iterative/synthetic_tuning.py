"""Tuning on a synthetic scan (parametric bootstrap): settings are tried where the true image is known.

The synthetic scan has the geometry and the noise of the real one and shows another method's image of the same log.
"""

from dataclasses import dataclass

import numpy as np

from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.iterative.descent import Floats, Images, OnIteration
from sawmill_tomography.reconstruction.iterative.penalised import Objective, descend
from sawmill_tomography.reconstruction.iterative.priors import Prior

# Limits of the descents from the reference image, which is near; both found on simulated logs (benchmarks/choosing.py).
ITERATIONS = 12
TOLERANCE = 1e-3
# The noise of the synthetic scan is part of the method: equal data give equal answers.
SEED = 23


@dataclass(frozen=True, eq=False)
class SyntheticTuning:
    """A scan and its synthetic counterpart.

    The real scan shows which settings give nearly another method's image, with the common errors of both methods. The
    synthetic scan shows which settings reproduce a known image, though of flatter wood than any real log. The
    best settings for the true log mostly lie between the two.
    """

    projector: Projector
    reference: Image  # (n, n) float32: another method's image of the scanned log: the truth of the synthetic scan
    lines: Images  # (2, views, detector) float32
    non_negative: bool

    @classmethod
    def of(
        cls, projector: Projector, line: Image, noise: Floats, reference: Image, *, non_negative: bool
    ) -> "SyntheticTuning":
        """Simulate the counterpart of a scan (views, detector) whose noise, float64, broadcasts with it."""
        drawn = np.where(np.isfinite(noise), noise, 0.0) * np.random.default_rng(SEED).standard_normal(line.shape)
        synthetic = projector.forward(reference) + drawn.astype(np.float32)
        return cls(projector, reference, np.stack([line, synthetic]), non_negative)

    def errors(
        self, weights: Images, prior: Prior, start: Images | None = None, on_iteration: OnIteration | None = None
    ) -> tuple[Floats, Images]:
        """Return each candidate's error, and its images (candidates, 2, n, n) of the real and the synthetic scan.

        `weights` (candidates, views, detector) float32. `start` (2, n, n) float32: start images; by default the
        reference.
        """
        start = np.stack([self.reference, self.reference]) if start is None else start
        count = len(weights)
        lines = np.tile(self.lines, (count, 1, 1))
        minimum = descend(
            Objective(self.projector, lines, np.repeat(weights, 2, axis=0), prior.repeated(2)),
            np.tile(start, (count, 1, 1)),
            non_negative=self.non_negative,
            iterations=ITERATIONS,
            tolerance=TOLERANCE,
            on_iteration=on_iteration,
        )
        images = minimum.images.reshape(count, *start.shape)
        return np.log(np.square(images - self.reference, dtype=np.float64).sum(axis=(2, 3))).sum(axis=1), images
