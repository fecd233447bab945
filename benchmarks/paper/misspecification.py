"""The gallery of wrong parameters: the log's FBP with the true theta, and with one parameter wrong at a time."""

from pathlib import Path

import numpy as np
from scanners import SCANNER
from scans import GRID, TRUE_FRAME, TRUE_THETA, log_image, log_quality, sources

from paper import pictures
from paper.experiment import Experiment, Plan, Result, Results, Unit, Values
from worker.tomography.geometry import Theta
from worker.tomography.ray_error import ray_error

PICTURES = (
    ("a", "true theta", (0.0, 0.0, 0.0, 0.0, 0.0)),
    ("b", "initial angle +0.1 rad", (0.1, 0.0, 0.0, 0.0, 0.0)),
    ("c", "detector to COR +50 mm", (0.0, 50.0, 0.0, 0.0, 0.0)),
    ("d", "source shift +20 mm", (0.0, 0.0, 20.0, 0.0, 0.0)),
    ("e", "detector shift +20 mm", (0.0, 0.0, 0.0, 20.0, 0.0)),
    ("f", "detector tilt +0.1", (0.0, 0.0, 0.0, 0.0, 0.1)),
)


def wrong_theta(letter: str) -> Theta:
    """The true theta with the letter's parameter wrong."""
    (change,) = (by for name, _, by in PICTURES if name == letter)
    return Theta.from_vector(TRUE_THETA.to_vector() + np.array(change))


def run(letter: str) -> Result:
    """One picture and its figures."""
    theta, source = wrong_theta(letter), sources()[0]
    error, similarity = log_quality(source, theta)
    frame = theta.source_frame(SCANNER.source_to_cor_mm)
    rays = ray_error(SCANNER, TRUE_FRAME, frame).rms_mm
    return {"relative_error": error, "ssim": similarity, "ray_error_mm": rays, "image": log_image(source, theta)}


def unit(letter: str) -> Unit:
    """One picture."""
    return Unit(f"misspecified-{letter}", run, {"letter": letter})


def units(plan: Plan) -> list[Unit]:  # noqa: ARG001 - as many as there are letters
    """The six pictures."""
    return [unit(letter) for letter, _, _ in PICTURES]


def section(plan: Plan, results: Results, folder: Path) -> Values:  # noqa: ARG001 - as many as there are letters
    """The gallery and its table."""
    drawn = pictures.figure(7.6, 5.4)
    panels = drawn.subplots(2, 3).ravel()
    truth = results[unit("a").name]["image"]
    limits = (float(np.percentile(truth, 5.0)), float(np.percentile(truth, 99.8)))
    rows = []
    for axes, (letter, title, _) in zip(panels, PICTURES, strict=True):
        found = results[unit(letter).name]
        pictures.show_image(axes, found["image"], GRID.field_mm, limits, f"({letter}) {title}")
        figures = [f"{found['relative_error']:.3f}", f"{found['ssim']:.3f}", f"{found['ray_error_mm']:.2f}"]
        rows.append([f"({letter})", title, *figures])
    pictures.save_greys(drawn, folder / "misspecification.png")
    letter, worst, _ = max(PICTURES, key=lambda picture: results[unit(picture[0]).name]["ray_error_mm"])
    return {
        "source": sources()[0],
        "turned": f"{results[unit('b').name]['ray_error_mm']:.2f}",
        "worst": worst,
        "worst_error": f"{results[unit(letter).name]['ray_error_mm']:.1f}",
        "table": pictures.table(("picture", "what is wrong", "relative error", "SSIM", "ray error, mm"), rows),
    }


EXPERIMENT = Experiment("misspecification", "One parameter wrong at a time", units, section)
