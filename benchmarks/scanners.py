"""Random scanners, scans and truths for the benchmarks: never the published data's own numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import (
    TAU,
    FloatArray,
    GeometryError,
    Scanner,
    SourceFrame,
    Theta,
    ThetaBounds,
    bounds_array,
)
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import Handedness, Rotation

SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.502864583)
CUSTOM = Phantom(
    "tee with a hole",
    (
        Polygon(((-110.0, -40.0), (60.0, -40.0), (60.0, -130.0), (115.0, -130.0), (115.0, 120.0), (-110.0, 20.0))),
        Disc((-60.0, -10.0), 18.0, -1.0),
    ),
)
PHANTOMS = (L_SHAPE, RECTANGLE_WITH_HOLE, CUSTOM)
VIEWS = (20, 30, 45, 60, 90, 120, 180, 360)
MOST_NOISE = 0.03
REACH_MM = 20.0


@dataclass(frozen=True)
class DrawnScanner:
    """A random scanner of the published bounds, and a phantom on it; whether they can be is for their user to see."""

    drawing: Phantom
    theta: Theta
    angles_rad: FloatArray
    position_mm: tuple[float, float]
    handedness: Handedness
    rotation: Rotation

    @property
    def seen(self) -> Phantom:
        """The phantom as the scanner sees it, at its position."""
        seen = self.drawing if self.handedness is Handedness.AS_DRAWN else self.drawing.mirrored()
        return seen.moved(*self.position_mm)


def draw_scanner(
    rng: np.random.Generator, phantoms: Sequence[Phantom], views: Sequence[int], off_centre_mm: float
) -> DrawnScanner:
    """Draw one of the phantoms near the centre of rotation, and a scanner with equidistant views all round."""
    ranges = bounds_array(ThetaBounds())
    drawing = phantoms[rng.integers(len(phantoms))]
    theta = Theta.from_vector(rng.uniform(ranges[:, 0], ranges[:, 1]))
    count = int(rng.choice(views))
    angles = np.arange(count) * TAU / count + rng.uniform(0.0, TAU)
    x, y = rng.uniform(-off_centre_mm, off_centre_mm, 2).tolist()
    handedness, rotation = list(Handedness)[rng.integers(2)], list(Rotation)[rng.integers(2)]
    return DrawnScanner(drawing, theta, angles, (x, y), handedness, rotation)


def leaves_air(shadow: FloatArray, cells: int) -> bool:
    """Return whether a shadow (views, cells) is in every view, and leaves air in this number of cells at both ends."""
    return bool(not shadow[:, :cells].any() and not shadow[:, -cells:].any() and shadow.any(axis=1).all())


@dataclass(frozen=True)
class RandomScan:
    """A scan and its true geometry."""

    task: CalibrationTask
    frame: SourceFrame
    theta: Theta
    handedness: Handedness
    rotation: Rotation
    noise: float


def random_scan(rng: np.random.Generator) -> RandomScan:
    """Draw a scanner from the published bounds whose shadow stays on the detector, and a noisy scan by it."""
    while True:
        phantom = PHANTOMS[rng.integers(len(PHANTOMS))]
        ranges = bounds_array(ThetaBounds())
        theta = Theta.from_vector(rng.uniform(ranges[:, 0], ranges[:, 1]))
        distance, direction = REACH_MM * np.sqrt(rng.uniform()), rng.uniform(0.0, TAU)
        position = (float(distance * np.cos(direction)), float(distance * np.sin(direction)))
        handedness = list(Handedness)[rng.integers(2)]
        rotation = list(Rotation)[rng.integers(2)]
        views = int(rng.choice(VIEWS))
        angles = np.arange(views) * TAU / views + rng.uniform(0.0, TAU)
        if rng.uniform() < 0.3:
            angles = angles + rng.uniform(-0.3, 0.3, views) * TAU / views
        noise = rng.uniform(0.0, MOST_NOISE)
        try:
            frame = theta.source_frame(SCANNER.source_to_cor_mm)
            if not analytic.clears(phantom.radius_mm + REACH_MM, frame):
                continue
            clean = analytic.project(
                phantom if handedness is Handedness.AS_DRAWN else phantom.mirrored(),
                DetectorCells.of(SCANNER),
                frame,
                rotation.apply(angles),
                position_mm=position,
                rays_per_cell=8,
            )
        except GeometryError:  # a corner of the bounds that no scanner can be in
            continue
        if not leaves_air(clean, 2):
            continue
        rms = np.sqrt(np.mean(clean**2))
        measured = rng.uniform(0.5, 2.0) * clean + rng.uniform(-5.0, 5.0)
        measured += noise * rms * rng.standard_normal(clean.shape)
        task = CalibrationTask(SCANNER, phantom, measured, angles)
        return RandomScan(task, frame, theta, handedness, rotation, noise)
