"""The tables of docs/understand/wood.md: methods on a CT slice of a tree disc, and on knots that are put into it.

    make wood

The slice is wood/tree-disc.npz in the folder that SAWMILL_PUBLISHED_DATA names. Its projections are computed: of pixels
of half the image's size, with two rays a cell, the published scanner's theta. Prints the tables, writes
benchmarks/results/wood.json and draws docs/pictures/wood-methods.png: the methods on a log of our own model.
"""

import io
import math
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from measurement import Measurement
from numpy.typing import NDArray
from PIL import Image
from scanners import SCANNER
from scans import TRUE_THETA
from scipy import ndimage

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Scanner
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.reconstruction.quality import relative_error
from sawmill_tomography.reconstruction.tikhonov import tikhonov
from sawmill_tomography.reconstruction.total_variation import ring_tv, total_variation

FloatImage = NDArray[np.float64]

METHODS = {"fbp": fbp, "tikhonov": tikhonov, "total_variation": total_variation, "ring_tv": ring_tv}
VIEWS, NOISES, KNOT_NOISE = (12, 20, 45, 90), (0.005, 0.02), 0.01
# Pixels of the truth, half as large as the image's, and the attenuation of a density of 1.
SIZE, PER_MM = 560, 0.018
AIR = 0.1
# Knots: width in mm, density relative to the wood around, direction from the pith; from 20 to 70 mm from the pith.
KNOTS = tuple(
    (width, denser, math.radians(20.0 + 60.0 * n))
    for n, (width, denser) in enumerate((width, denser) for denser in (1.15, 1.45) for width in (10.0, 15.0, 25.0))
)
FROM_MM, TO_MM = 20.0, 70.0
# A knot that is hardly denser than the rings around it vary has no contrast that could be measured beside them.
SHOWN = tuple(n for n, (_, denser, _) in enumerate(KNOTS) if denser > 1.3)
PITH = (232.5, 232.5)
SEED = 53
# The picture's log, the height of its slice, which cuts knots, its views and its greys.
PICTURE, LOG_RADIUS_MM, LOG_HEIGHT_MM, LOG_VIEWS = "docs/pictures/wood-methods.png", 105.0, 75.0, 20
GREYS = 48


def read_disc() -> tuple[FloatImage, float, tuple[float, float]]:
    """Return the disc's attenuation (SIZE, SIZE) in 1/mm, the pixel in mm, and the pith's place in pixels."""
    path = Path(os.environ.get("SAWMILL_PUBLISHED_DATA", "../shared/data")) / "wood/tree-disc.npz"
    if not path.is_file():
        sys.exit(f"no CT slice at {path}: docs/understand/wood.md tells how to get it")
    with np.load(path) as stored:
        density, pixel_mm = stored["stored"] / 1000.0, float(stored["pixel_mm"])
    before = [(SIZE - n) // 2 for n in density.shape]
    around = [(first, SIZE - n - first) for first, n in zip(before, density.shape, strict=True)]
    whole = np.pad(np.where(density < AIR, 0.0, density), around)
    return PER_MM * whole, pixel_mm, (before[0] + PITH[0], before[1] + PITH[1])


def with_knots(
    disc: FloatImage, pixel_mm: float, pith: tuple[float, float]
) -> tuple[FloatImage, list[NDArray[np.bool_]]]:
    """Return the disc with radial knots, and each knot's pixels."""
    x, y = ((np.arange(SIZE) + 0.5 - at) * pixel_mm for at in pith)
    image, masks = disc.copy(), []
    smooth = ndimage.gaussian_filter(disc, 5.0 / pixel_mm)
    for width, denser, direction in KNOTS:
        along = x[:, None] * math.cos(direction) + y * math.sin(direction)
        across = y * math.cos(direction) - x[:, None] * math.sin(direction)
        inside = (along > FROM_MM) & (along < TO_MM) & (np.abs(across) < 0.5 * width)
        image = np.where(inside, denser * smooth, image)
        masks.append(inside)
    return image, masks


def halved(image: FloatImage) -> FloatImage:
    """Return an image with pixels of twice the size."""
    n = len(image) // 2
    mean: FloatImage = image.reshape(n, 2, n, 2).mean(axis=(1, 3))
    return mean


def scan_of(disc: FloatImage, pixel_mm: float, views: int, noise: float) -> tuple[Projector, FloatImage]:
    """Return the projector, and computed projections with noise, (views, cells)."""
    angles, field_mm = (np.arange(views) + 0.5) * TAU / views, SIZE * pixel_mm
    fine = Scanner(SCANNER.source_to_cor_mm, 2 * SCANNER.num_detector_pixels, SCANNER.detector_pitch_mm / 2.0)
    rays = Projector(FanBeamGeometry(fine, TRUE_THETA, angles), ImageGrid(SIZE, field_mm)).forward(disc)
    lines = rays.reshape(views, -1, 2).mean(axis=2, dtype=np.float64)
    deviation = noise * math.sqrt(np.mean(lines**2))
    lines += deviation * np.random.default_rng((SEED, views)).standard_normal(lines.shape)
    return Projector(FanBeamGeometry(SCANNER, TRUE_THETA, angles), ImageGrid(SIZE // 2, field_mm)), lines


def images_of(
    disc: FloatImage, pixel_mm: float, views: int, noise: float, names: Sequence[str] = tuple(METHODS)
) -> Mapping[str, FloatImage]:
    """Return the image by each method, from computed projections with noise."""
    projector, lines = scan_of(disc, pixel_mm, views, noise)
    return {name: np.asarray(METHODS[name](projector, lines).image, np.float64) for name in names}


def contrasts(image: FloatImage, truth: FloatImage, masks: Sequence[NDArray[np.bool_]]) -> list[float]:
    """Return the share of its contrast that each knot keeps, against the wood within 5 mm around all knots."""
    every = halved(np.any(masks, axis=0).astype(np.float64))
    near = ndimage.binary_dilation(every > 0.0, iterations=6) & ~ndimage.binary_dilation(every > 0.0, iterations=1)
    kept = []
    for mask in masks:
        whole = halved(mask.astype(np.float64))
        inside = whole == 1.0
        around = near & ndimage.binary_dilation(whole > 0.0, iterations=6)
        kept.append(
            float((image[inside].mean() - image[around].mean()) / (truth[inside].mean() - truth[around].mean()))
        )
    return kept


def draw_methods(pixel_mm: float) -> None:
    """Draw a slice of our own log model, and its image by each method."""
    body = LogModel.random(SEED, radius_mm=LOG_RADIUS_MM).slice_at(LOG_HEIGHT_MM)
    log = body.rasterise(SIZE, SIZE * pixel_mm).astype(np.float64)
    truth = halved(log)
    figure = Figure(figsize=(10.0, 2.2), layout="constrained")
    shown = {"the log": truth, **images_of(log, pixel_mm, LOG_VIEWS, KNOT_NOISE)}
    for axes, (name, image) in zip(figure.subplots(1, len(shown)), shown.items(), strict=True):
        axes.imshow(image.T, origin="lower", cmap="gray", vmin=0.0, vmax=truth.max())
        error = "" if image is truth else f", {relative_error(image, truth):.3f}"
        axes.set_title(f"{name}{error}", fontsize=9)
        axes.set_axis_off()
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=120)
    Image.open(stream).convert("L").quantize(GREYS).save(Path(__file__).parents[1] / PICTURE, optimize=True)


def main() -> None:
    """Print the tables, and write the results."""
    measurement = Measurement.begin("worker/sawmill_tomography/reconstruction")
    disc, pixel_mm, pith = read_disc()
    draw_methods(pixel_mm)
    names = list(METHODS)
    rows = [f"| views | noise | {' | '.join(f'`{name}`' for name in names)} |", f"|---|---|{'---|' * len(names)}"]
    errors: dict[str, float] = {}
    for noise in NOISES:
        for views in VIEWS:
            images = images_of(disc, pixel_mm, views, noise)
            found = {name: relative_error(image, halved(disc)) for name, image in images.items()}
            rows.append(f"| {views} | {100.0 * noise:g} % | {' | '.join(f'{found[name]:.3f}' for name in names)} |")
            print(rows[-1], flush=True)
            errors.update({f"{name}_{views}_{1000 * noise:g}": round(error, 4) for name, error in found.items()})
    knotted, masks = with_knots(disc, pixel_mm, pith)
    heads = " | ".join(
        f"{width:g} mm, +{100.0 * (denser - 1.0):.0f} %" for width, denser, _ in (KNOTS[n] for n in SHOWN)
    )
    knots = [f"| views | method | {heads} |", f"|---|---|{'---|' * len(SHOWN)}"]
    for views in VIEWS:
        images = images_of(knotted, pixel_mm, views, KNOT_NOISE, ("total_variation", "ring_tv"))
        for name, image in images.items():
            kept = contrasts(image, halved(knotted), masks)
            knots.append(f"| {views} | `{name}` | {' | '.join(f'{kept[n]:.2f}' for n in SHOWN)} |")
            print(knots[-1], flush=True)
    values = {"source": "published", "table": "\n".join(rows), "knots": "\n".join(knots), **errors}
    measurement.write({"wood": values}, timed=False)


if __name__ == "__main__":
    main()
