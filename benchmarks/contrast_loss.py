"""The loss of contrast that a wrong geometry causes: predicted, and as images of disturbed scans show it.

    python benchmarks/contrast_loss.py [--scans 50] [--write]

Each of four scanners has errors of its geometry drawn from one covariance. A log of knots of 10 mm is simulated with
the disturbed geometry, and reconstructed with the undisturbed one by `fbp`. Each knot is measured about its centre of
mass, and compared with an undisturbed one as large as the image's scale makes it: a shift and a common scale blur
nothing. The MTF is measured on pins. Two minutes of a core.
"""

import argparse
from dataclasses import dataclass, replace

import numpy as np
from measurement import Measurement
from rich.progress import track
from scipy import ndimage
from scipy.special import j0

from sawmill_tomography.geometry.contrast_loss import (
    AROUND,
    KNOT_MM,
    MTF_PER_MM,
    contrast_loss,
    contrast_loss_bound,
)
from sawmill_tomography.geometry.detector_shape import FloatArray
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Scanner, SourceFrame, to_vector
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.geometry.ray_error import RINGS, predicted_ray_error
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_vocabulary import DetectorModule, Disc

MEASURES = tuple(f"worker/sawmill_tomography/geometry/{name}.py" for name in ("contrast_loss", "ray_error"))
# Pixels to a cell's width at the COR, over which their mean is taken; the parts of the image around knots and pins.
FINER, NEAR_MM, REACH_MM, PIN_MM = 3, 12.0, 18.0, 2.0
# Sizes of knots and pins, relative to their own. Losses below this share are not compared.
SCALES, LEAST = (0.95, 1.0, 1.05), 0.05
FLAT, NARROW = Scanner(859.46, 256, 4.5), Scanner(859.46, 768, 1.5)
MODULES = replace(NARROW, detector_modules=(DetectorModule(256, 0.0, 0.0), DetectorModule(512, 0.0, 0.0)))
FRAME = SourceFrame(0.3, 880.0, 1600.0, -30.0, -0.08)


@dataclass(frozen=True)
class Disturbed:
    """A scanner whose geometry has errors with these standard deviations: (R, SDD, u_c, tau) and of each module."""

    scanner: Scanner
    frame: SourceFrame
    deviations: tuple[float, ...]
    radius_mm: float = 120.0
    views: int = 480

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the errors, with that of psi."""
        return np.diag(np.square((0.01, *self.deviations)))

    def geometry(self, error: FloatArray) -> FanBeamGeometry:
        """Return the geometry with an error of `covariance`."""
        frame = SourceFrame(*(to_vector(self.frame) + error[:5]).tolist())
        modules = tuple(
            DetectorModule(module.first_cell, module.gap_mm + gap, module.kink_rad + kink)
            for module, (gap, kink) in zip(self.scanner.detector_modules, error[5:].reshape(-1, 2), strict=True)
        )
        scanner = replace(self.scanner, detector_modules=modules)
        theta = frame.theta(min(self.scanner.source_to_cor_mm, frame.source_distance_mm))
        scanner = replace(scanner, source_to_cor_mm=min(self.scanner.source_to_cor_mm, frame.source_distance_mm))
        return FanBeamGeometry(scanner, theta, TAU * np.arange(self.views) / self.views)


SCANNERS = {
    "wide cells": Disturbed(FLAT, FRAME, (5.0, 20.0, 2.0, 0.01)),
    "narrow cells": Disturbed(NARROW, FRAME, (5.0, 20.0, 1.2, 0.03)),
    "modules": Disturbed(MODULES, FRAME, (5.0, 20.0, 1.0, 0.01, 0.6, 0.004, 0.6, 0.004)),
    "tilted": Disturbed(NARROW, SourceFrame(0.3, 860.0, 1300.0, 80.0, 0.3), (5.0, 20.0, 1.0, 0.02), radius_mm=150.0),
}


class Log:
    """A log of knots, with pins opposite to them, as one scanner shows it."""

    def __init__(self, of: Disturbed) -> None:
        turns, radii = 2.399963 * np.arange(RINGS), of.radius_mm * np.sqrt((np.arange(RINGS) + 0.5) / RINGS)
        self.of, self.known, self.places = of, of.geometry(np.zeros(len(of.covariance))), radii * np.exp(1j * turns)
        size = int(FINER * 2.0 * (of.radius_mm + REACH_MM + NEAR_MM) / self.known.cell_at_cor_mm)
        self.grid = ImageGrid(size, size * self.known.cell_at_cor_mm / FINER)
        self.projector = Projector(self.known, self.grid)
        middles = self.grid.low_mm[0] + (np.arange(size) + 0.5) * self.grid.pixel_mm
        self.pixels = middles[:, None] + 1j * middles
        # What the undisturbed geometry shows of knots and pins of other sizes: polynomials of the size.
        shown = [self.shown(self.image(self.known, scale), scale)[0].ravel() for scale in SCALES]
        self.undisturbed = np.polyfit(SCALES, shown, 2)

    def image(self, truth: FanBeamGeometry, scale: float = 1.0) -> FloatArray:
        """Return the image of knots and pins of this size, whose pixels are means over a cell's width at the COR."""
        knots = [Disc((at.real, at.imag), 0.5 * KNOT_MM * scale, 1.0 / scale) for at in self.places.tolist()]
        pins = [Disc((-at.real, -at.imag), 0.5 * PIN_MM * scale) for at in self.places.tolist()]
        lines = simulate_sinogram(Phantom("log", (*knots, *pins)), truth, noise=0.0, seed=0)
        return ndimage.uniform_filter(np.asarray(fbp(self.projector, lines).image, np.float64), FINER)

    def shown(self, image: FloatArray, scale: float | None = None) -> tuple[FloatArray, float]:
        """Measure the knots' contrasts and the pins' MTF, (2, knots), and the image's scale if it is not known."""
        knots, pins = (self._centred(image, way * self.places) for way in (1.0, -1.0))
        scale = scale or float(np.abs(knots - pins).mean() / (2.0 * np.abs(self.places)).mean())
        values = []
        for knot, pin in zip(knots, pins, strict=True):
            there, away = self._near(image, knot)
            inside, inner, outer = (self._within(away, 0.5 * KNOT_MM * size * scale) for size in (1.0, *AROUND))
            ring = outer - inner
            contrast = (inside * there).sum() / inside.sum() - (ring * there).sum() / ring.sum()
            there, away = self._near(image, pin)
            there = there * self._within(away, REACH_MM)
            values.append((contrast, (there * j0(TAU * MTF_PER_MM * np.abs(away))).sum() / there.sum()))
        return np.array(values).T, scale

    def losses(self, error: FloatArray) -> FloatArray:
        """Return the mean losses of the knots' contrast and of the MTF where the truth has this error, (2,)."""
        shown, scale = self.shown(self.image(self.of.geometry(error)))
        undisturbed = scale ** np.arange(2, -1, -1) @ self.undisturbed
        return np.asarray(1.0 - (shown.ravel() / undisturbed).reshape(shown.shape).mean(axis=1))

    def _centred(self, image: FloatArray, at: FloatArray) -> FloatArray:
        """Return the centres of mass near these places, complex (places,)."""
        centres = []
        for centre in at.tolist():
            for _ in range(8):
                there, away = self._near(image, centre)
                there = there * self._within(away, NEAR_MM)
                centre += (away * there).sum() / there.sum()  # noqa: PLW2901 - it is refined
            centres.append(centre)
        return np.array(centres)

    def _near(self, image: FloatArray, place: complex) -> tuple[FloatArray, FloatArray]:
        """Return the part of the image around a place, and each pixel's way from it, x + iy."""
        x, y = (int((way - self.grid.low_mm[0]) / self.grid.pixel_mm) for way in (place.real, place.imag))
        half = int(REACH_MM / self.grid.pixel_mm) + 2
        there = np.s_[x - half : x + half + 1, y - half : y + half + 1]
        return image[there], self.pixels[there] - place

    def _within(self, away: FloatArray, radius_mm: float) -> FloatArray:
        """Return the share of each pixel within a radius."""
        return np.clip((radius_mm - np.abs(away)) / self.grid.pixel_mm + 0.5, 0.0, 1.0)


def compared(of: Disturbed, scans: int, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the losses of knots and of the MTF, seen and predicted (scans, 2), and their bounds (2,)."""
    rng = np.random.default_rng(seed)
    errors = rng.multivariate_normal(np.zeros(len(of.covariance)), of.covariance, size=scans)
    log = Log(of)
    seen = np.minimum([log.losses(error) for error in track(errors)], 1.0)
    where = of.scanner, of.frame
    losses = [contrast_loss(*where, error, radius_mm=of.radius_mm) for error in errors]
    upper_mm = predicted_ray_error(*where, of.covariance, radius_mm=of.radius_mm).upper_95_mm
    bound = contrast_loss_bound(*where, of.covariance, upper_mm, radius_mm=of.radius_mm)
    both = [0.01 * np.array([one.knot_10_mm_percent, one.mtf_percent]) for one in (*losses, bound)]
    return seen, np.array(both[:-1]), both[-1]


def main() -> None:
    """Compare all scanners, print a line each, and write the values."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scans", type=int, default=50, help="scans of each scanner")
    parser.add_argument("--write", action="store_true", help="write benchmarks/results/contrast-loss.json")
    chosen = parser.parse_args()
    measurement = Measurement.begin(*MEASURES)
    lines, beyond = (
        ["| scanner | knots lose, mean | predictions differ, knots | MTF |", "|---|---|---|---|"],
        np.zeros(2, int),
    )
    compared_losses, worst = 0, np.zeros(2)
    for seed, (name, of) in enumerate(SCANNERS.items(), start=5600):
        seen, predicted, bound = compared(of, chosen.scans, seed)
        off = np.where(seen > LEAST, np.abs(predicted / seen - 1.0), 0.0).max(axis=0)
        lines.append(f"| {name} | {seen[:, 0].mean():.1%} | {off[0]:.1%} | {off[1]:.1%} |")
        beyond += (seen > bound).sum(axis=0)
        compared_losses, worst = compared_losses + int((seen > LEAST).any(axis=1).sum()), np.maximum(worst, off)
        print(lines[-1], bound, (seen > bound).sum(axis=0))
    if chosen.write:
        values = {
            "scans": chosen.scans * len(SCANNERS),
            "compared": compared_losses,
            "knots_differ_percent": 100.0 * worst[0],
            "mtf_differs_percent": 100.0 * worst[1],
            "knots_beyond_bound": int(beyond[0]),
            "mtf_beyond_bound": int(beyond[1]),
            "table": "\n".join(lines),
        }
        measurement.write({"contrast-loss": values}, timed=False)


if __name__ == "__main__":
    main()
