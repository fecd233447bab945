"""Draw docs/pictures/fit.png: a scan of the phantom, less its prediction by tape measure, and by the calibration.

    python docs/tools/fit_drawing.py [FOLDER]

The scan, the tape's errors and the calibration are those of the demo.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from geometry_drawing import plt
from PIL import Image
from scipy.optimize import least_squares

from sawmill_command import examples
from sawmill_command.demo import TAPE_ERROR
from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import FloatArray, Theta, to_vector
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.projection.analytic import DetectorCells, project

FOLDER = Path(__file__).parents[1] / "pictures"
VIEWS = 360
# Cells on both sides of the shadow.
MARGIN = 20
CAPTIONS = ("the scan", "minus the prediction by tape", "minus the prediction by calibration")


def scan_and_differences() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a scan of the phantom (views, cells), less its prediction by tape measure, and less the calibration's.

    The prediction by tape measure has the phantom's best place and first angle.
    """
    row = slice(examples.PHANTOM_ROWS - 1, examples.PHANTOM_ROWS)
    stack, angles = examples.mill_stack(VIEWS, examples.mill_slices()[row]), examples.full_turn(VIEWS)
    dark = stack.darks.mean()
    lines = -np.log(np.maximum(stack.counts - dark, 1.0) / (stack.flats.mean(axis=0) - dark))
    sinogram = lines[:, 0].astype(np.float64)
    found = calibrate(CalibrationTask(examples.SCANNER, L_SHAPE, sinogram, angles, from_counts=True))
    fit, cells = found.findings.fit, DetectorCells.of(examples.SCANNER)
    taped = Theta.from_vector(to_vector(examples.THETA) + to_vector(TAPE_ERROR))
    frame = taped.source_frame(examples.SCANNER.source_to_cor_mm)
    phantom, angles = found.task.phantoms[found.handedness], found.rotation.apply(angles)

    def difference(place: FloatArray) -> FloatArray:
        x, y, psi = place
        model = project(phantom, cells, replace(frame, psi_rad=psi), angles, position_mm=(x, y))
        return np.asarray(sinogram - fit.gain * model - fit.offset)

    start = (*fit.position_mm, fit.frame.psi_rad)
    best = least_squares(lambda place: difference(place).ravel(), start, x_scale=(1.0, 1.0, 1e-3)).x
    return sinogram, difference(best), found.residual


def main() -> None:
    """Write the drawing."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    images = scan_and_differences()
    scan, by_tape, _ = images
    shaded = np.flatnonzero((scan > 0.1 * scan.max()).any(axis=0))
    shown = slice(max(int(shaded[0]) - MARGIN, 0), int(shaded[-1]) + MARGIN)
    limit = float(np.percentile(np.abs(by_tape), 99.5))
    figure, panels = plt.subplots(1, 3, figsize=(11.0, 4.0), layout="constrained", facecolor="white")
    for number, (panel, image, caption) in enumerate(zip(panels, images, CAPTIONS, strict=True)):
        colours = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit} if number else {"cmap": "gray"}
        # A mean of two views and two cells: half the noise is half the file.
        drawn = image[:, shown][:, : (shown.stop - shown.start) // 2 * 2]
        drawn = drawn.reshape(VIEWS // 2, 2, -1, 2).mean(axis=(1, 3))
        panel.imshow(drawn, aspect="auto", interpolation="nearest", **colours)
        panel.set_title(caption, fontsize=14)
        panel.set(xticks=[], yticks=[])
    panels[0].set_xlabel("along the detector", fontsize=12)
    panels[0].set_ylabel("one turn, from top to bottom", fontsize=12)
    path = folder / "fit.png"
    figure.savefig(path, dpi=90)
    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(160, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    small.save(path, optimize=True)


if __name__ == "__main__":
    main()
