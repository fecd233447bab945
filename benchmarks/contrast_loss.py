"""The loss of contrast that a wrong geometry causes: predicted, and as images of disturbed scans show it.

    python benchmarks/contrast_loss.py [--scans 50] [--write]

Knots of 10 mm are simulated with disturbed geometries and reconstructed with the undisturbed one by `fbp`. Each is
measured about its centre of mass, and compared with an undisturbed one as large. Pins show the MTF. Two minutes.
"""

import argparse
from dataclasses import replace

import numpy as np
from measurement import Measurement
from rich.progress import track
from scipy import ndimage
from scipy.special import j0

from sawmill_tomography.geometry.contrast_loss import AROUND, KNOT_MM, MTF_PER_MM, contrast_loss, contrast_loss_bound
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray, Scanner, SourceFrame, to_vector
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.geometry.ray_error import RINGS, predicted_ray_error
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_vocabulary import DetectorModule, Disc

MEASURES = [f"worker/sawmill_tomography/geometry/{name}.py" for name in ("contrast_loss", "ray_error")]
VIEWS, RADIUS_MM = 480, 120.0
# Pixels to a cell's width at the COR, over which their mean is taken; how far a knot's image reaches; a pin's diameter.
FINER, REACH_MM, PIN_MM = 3, 18.0, 2.0
SCALES, LEAST = (0.95, 1.0, 1.05), 0.05  # relative sizes of knots and pins; losses below this share are not compared
FLAT, NARROW = Scanner(859.46, 256, 4.5), Scanner(859.46, 768, 1.5)
MODULES = replace(NARROW, detector_modules=(DetectorModule(256, 0.0, 0.0), DetectorModule(512, 0.0, 0.0)))
FRAME, TILTED = SourceFrame(0.3, 890.0, 1600.0, -30.0, -0.08), SourceFrame(0.3, 890.0, 1300.0, 80.0, 0.3)
# Scanners, and standard deviations of their (psi, R, SDD, u_c, tau), and of each module's gap and kink.
SCANNERS = {
    "wide cells": (FLAT, FRAME, (0.01, 3.0, 10.0, 2.0, 0.01)),
    "narrow cells": (NARROW, FRAME, (0.01, 3.0, 10.0, 1.2, 0.03)),
    "modules": (MODULES, FRAME, (0.01, 3.0, 10.0, 1.0, 0.01, 0.6, 0.004, 0.6, 0.004)),
    "tilted": (NARROW, TILTED, (0.01, 3.0, 10.0, 1.0, 0.02)),
}


class Log:
    """A log of knots, as a scanner's undisturbed geometry shows it."""

    def __init__(self, scanner: Scanner, frame: SourceFrame) -> None:
        """Measure what is shown of knots of other sizes: a polynomial of the size."""
        self.scanner, self.frame = scanner, frame
        known = self.geometry(np.zeros(5 + 2 * len(scanner.detector_modules)))
        size = int(FINER * 2.0 * (RADIUS_MM + 2.0 * REACH_MM) / known.cell_at_cor_mm)
        self.projector = Projector(known, ImageGrid(size, size * known.cell_at_cor_mm / FINER))
        self.pixel_mm = self.projector.grid.pixel_mm
        knots = RADIUS_MM * np.sqrt((np.arange(RINGS) + 0.5) / RINGS) * np.exp(2.399963j * np.arange(RINGS))
        self.places = np.concatenate([knots, -knots])  # of knots, and of pins opposite, dense above the knots' streaks
        self.undisturbed = np.polyfit(SCALES, [self.shown(known, scale)[0].ravel() for scale in SCALES], 2)

    def geometry(self, error: FloatArray) -> FanBeamGeometry:
        """Return the geometry with an error."""
        frame = SourceFrame(*(to_vector(self.frame) + error[:5]).tolist())
        firsts = [module.first_cell for module in self.scanner.detector_modules]
        modules = [DetectorModule(cell, *move) for cell, move in zip(firsts, error[5:].reshape(-1, 2), strict=True)]
        scanner = replace(self.scanner, detector_modules=tuple(modules))
        return FanBeamGeometry(scanner, frame.theta(scanner.source_to_cor_mm), TAU * np.arange(VIEWS) / VIEWS)

    def shown(self, truth: FanBeamGeometry, size: float | None = None) -> tuple[FloatArray, float]:
        """Measure knots' contrasts and pins' MTF, (2, knots), of this size or of the size that the scale makes."""
        radii, densities = np.repeat([[0.5 * KNOT_MM, 0.5 * PIN_MM], [1.0, 5.0]], RINGS, axis=1).tolist()
        discs = [
            Disc((at.real, at.imag), radius * (size or 1.0), density)
            for at, radius, density in zip(self.places, radii, densities, strict=True)
        ]
        lines = simulate_sinogram(Phantom("log", tuple(discs)), truth, noise=0.0, seed=0) / (size or 1.0)
        image = ndimage.uniform_filter(np.asarray(fbp(self.projector, lines).image, np.float64), FINER)
        at = np.array([self._centre(image, place) for place in self.places])
        scale = size or float((np.abs(at - at.mean()) / np.abs(self.places)).mean())
        contrasts, mtf = np.array([self._measured(*self._near(image, centre), scale) for centre in at]).T
        return np.stack([contrasts[:RINGS], mtf[RINGS:]]), scale

    def losses(self, error: FloatArray) -> FloatArray:
        """Return the mean losses of the knots' contrast and of the MTF where the truth has this error, (2,)."""
        shown, scale = self.shown(self.geometry(error))
        undisturbed = (scale ** np.arange(2, -1, -1) @ self.undisturbed).reshape(shown.shape)
        return np.asarray(np.minimum(1.0 - (shown / undisturbed).mean(axis=1), 1.0))

    def _measured(self, image: FloatArray, away: FloatArray, scale: float) -> tuple[float, float]:
        """Return the contrast of a knot, and the MTF if it is a pin."""
        inside, inner, outer = (self._within(away, 0.5 * KNOT_MM * size * scale) for size in (1.0, *AROUND))
        around, near = outer - inner, self._within(away, REACH_MM) * image
        contrast = (inside * image).sum() / inside.sum() - (around * image).sum() / around.sum()
        return float(contrast), float((near * j0(TAU * MTF_PER_MM * np.abs(away))).sum() / near.sum())

    def _centre(self, image: FloatArray, centre: complex) -> complex:
        """Return the centre of mass near a place."""
        for _ in range(8):
            there, away = self._near(image, centre)
            there = there * self._within(away, REACH_MM / 1.5)
            centre += complex((away * there).sum() / there.sum())
        return centre

    def _near(self, image: FloatArray, place: complex) -> tuple[FloatArray, FloatArray]:
        """Return the part of the image around a place, and each pixel's way from it, x + iy."""
        half, low_mm = int(REACH_MM / self.pixel_mm) + 2, self.projector.grid.low_mm[0]
        parts = [np.arange(-half, half + 1) + int((way - low_mm) / self.pixel_mm) for way in (place.real, place.imag)]
        x, y = (low_mm + (part + 0.5) * self.pixel_mm for part in parts)
        return image[np.ix_(*parts)], x[:, None] + 1j * y - place

    def _within(self, away: FloatArray, radius_mm: float) -> FloatArray:
        """Return the share of each pixel within a radius."""
        return np.clip((radius_mm - np.abs(away)) / self.pixel_mm + 0.5, 0.0, 1.0)


def compared(name: str, scans: int, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the losses of knots and of the MTF, seen and predicted (scans, 2), and their bounds (2,)."""
    scanner, frame, deviations = SCANNERS[name]
    errors = np.random.default_rng(seed).standard_normal((scans, len(deviations))) * deviations
    log, covariance = Log(scanner, frame), np.diag(np.square(deviations))
    losses = [contrast_loss(scanner, frame, error, radius_mm=RADIUS_MM) for error in errors]
    upper_mm = predicted_ray_error(scanner, frame, covariance, radius_mm=RADIUS_MM).upper_95_mm
    losses.append(contrast_loss_bound(scanner, frame, covariance, upper_mm, radius_mm=RADIUS_MM))
    predicted = 0.01 * np.array([(one.knot_10_mm_percent, one.mtf_percent) for one in losses])
    return np.array([log.losses(error) for error in track(errors)]), predicted[:-1], predicted[-1]


def main() -> None:
    """Compare all scanners, print a table, and write the values."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scans", type=int, default=50, help="scans of each scanner")
    parser.add_argument("--write", action="store_true", help="write benchmarks/results/contrast-loss.json")
    chosen, measurement = parser.parse_args(), Measurement.begin(*MEASURES)
    lines = [
        "| scanner | scans | knots lose, mean | predictions differ, knots | MTF | beyond bounds |",
        "|---" * 6 + "|",
    ]
    for seed, name in enumerate(SCANNERS, start=5600):
        seen, predicted, bound = compared(name, chosen.scans, seed)
        off = np.where(seen > LEAST, np.abs(predicted / seen - 1.0), 0.0).max(axis=0)
        beyond = (seen > bound).sum(axis=0)
        differ = f"{seen[:, 0].mean():.1%} | {off[0]:.1%} | {off[1]:.1%}"
        lines.append(f"| {name} | {chosen.scans} | {differ} | {beyond[0]}, {beyond[1]} |")
    print("\n".join(lines))
    if chosen.write:
        measurement.write({"contrast-loss": {"table": "\n".join(lines)}}, timed=False)


if __name__ == "__main__":
    main()
