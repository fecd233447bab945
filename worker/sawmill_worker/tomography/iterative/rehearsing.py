"""Choosing settings by a rehearsal: the scan is imitated with a log that looks like the scanned one and is known."""

from dataclasses import dataclass

import numpy as np

from sawmill_worker.tomography.iterative.descent import Floats, Images, Progress
from sawmill_worker.tomography.iterative.penalised import Objective, Prior, descend
from sawmill_worker.tomography.projector import Image, Projector

# From the known log, which is near.
ITERATIONS = 12
TOLERANCE = 1e-3
# The imitation's noise is part of the method: equal data give equal answers.
SEED = 23


@dataclass(frozen=True, eq=False)
class Tried:
    """What candidates were worth.

    Attributes
    ----------
    errors : (candidates,) float64
        Sum of the logarithms of the squared distances from the known log, of the scan's image and of the imitation's.
    images : (candidates, 2, n, n) float32
        Of the scan and of the imitation.
    """

    errors: Floats
    images: Images


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """A scan and its imitation.

    The scan's image tells which settings come near to what another method makes of it, with whatever errors the two
    methods have in common; the imitation's, which settings find a log that is known, though of flatter wood than any
    that grew. The true log's best settings lie mostly between the two.

    Attributes
    ----------
    known : (n, n) float32
        Another method's image of the scanned log, which is what the imitation shows.
    lines : (2, views, detector) float32
        The scan's and the imitation's, which has noise of its own.
    """

    projector: Projector
    known: Image
    lines: Images
    non_negative: bool

    @classmethod
    def of(cls, projector: Projector, line: Image, noise: Floats, known: Image, *, non_negative: bool) -> "Rehearsal":
        """Imitate a scan (views, detector) whose noise, float64, broadcasts with it."""
        drawn = noise * np.random.default_rng(SEED).standard_normal(line.shape)
        imitation = projector.forward(known) + drawn.astype(np.float32)
        return cls(projector, known, np.stack([line, imitation]), non_negative)

    def try_out(
        self, weights: Images, prior: Prior, start: Images | None = None, progress: Progress | None = None
    ) -> Tried:
        """Reconstruct both with each candidate, side by side.

        Parameters
        ----------
        weights : (candidates, views, detector) float32
        prior : Prior
            Of as many images.
        start : (2, n, n) float32, optional
            By default the known log.
        """
        if start is None:
            start = np.stack([self.known, self.known])
        found = descend(
            self._objective(weights, prior),
            np.tile(start, (len(weights), 1, 1)),
            non_negative=self.non_negative,
            iterations=ITERATIONS,
            tolerance=TOLERANCE,
            progress=progress,
        )
        images = found.images.reshape(len(weights), *start.shape)
        return Tried(np.log(np.square(images - self.known, dtype=np.float64).sum(axis=(2, 3))).sum(axis=1), images)

    def _objective(self, weights: Images, prior: Prior) -> Objective:
        """For each candidate the scan and the imitation, in turn."""
        return Objective(
            self.projector, np.tile(self.lines, (len(weights), 1, 1)), np.repeat(weights, 2, axis=0), prior.each(2)
        )
