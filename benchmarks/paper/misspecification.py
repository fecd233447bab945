"""The paper's gallery of misspecified parameters, and one parameter wrong at a time: the log's FBP with each theta."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scanners import SCANNER
from scans import GRID, TRUE_FRAME, TRUE_THETA, log_image, log_quality, sources

from paper import pictures
from paper.experiment import Experiment, Plan, Result, Results, Unit, Values
from sawmill_tomography.geometry.geometry import Theta, angle_difference, to_vector
from sawmill_tomography.geometry.ray_error import ray_error

Five = tuple[float, float, float, float, float]
# The paper says that its epsilon is small and prints no number: this one is ours.
EPSILON_MM = 50.0


@dataclass(frozen=True)
class Case:
    """A theta that is wrong: what is left of the true one (1 or 0 for each number), and what is added to it."""

    name: str
    words: str
    left: Five = (1.0, 1.0, 1.0, 1.0, 1.0)
    added: Five = (0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def theta(self) -> Theta:
        """The wrong theta."""
        return Theta.from_vector(to_vector(TRUE_THETA) * np.array(self.left) + np.array(self.added))


# The paper's letters; a zero where a parameter is left out.
GALLERY = (
    Case("a", "[alpha0, r_D, 0, 0, 0]", left=(1.0, 1.0, 0.0, 0.0, 0.0)),
    Case("b", "[alpha0, r_D, h_S, 0, 0]", left=(1.0, 1.0, 1.0, 0.0, 0.0)),
    Case("c", "[alpha0, r_D, h_S, h_D, 0]", left=(1.0, 1.0, 1.0, 1.0, 0.0)),
    Case("d", "[alpha0, r_D, 0, 0, alpha_D]", left=(1.0, 1.0, 0.0, 0.0, 1.0)),
    Case("e", f"[alpha0, r_D + {EPSILON_MM:.0f} mm, h_S, h_D, alpha_D]", added=(0.0, EPSILON_MM, 0.0, 0.0, 0.0)),
    Case("f", "true theta"),
)
# Small errors of the parameters that the gallery changes by their whole size or not at all.
ALONE = (
    Case("initial-angle", "initial angle +0.1 rad", added=(0.1, 0.0, 0.0, 0.0, 0.0)),
    Case("source-shift", "source shift +20 mm", added=(0.0, 0.0, 20.0, 0.0, 0.0)),
    Case("detector-shift", "detector shift +20 mm", added=(0.0, 0.0, 0.0, 20.0, 0.0)),
    Case("detector-tilt", "detector tilt +0.1", added=(0.0, 0.0, 0.0, 0.0, 0.1)),
)


def run(theta: list[float]) -> Result:
    """Reconstruct the log with a theta, and compare the image with the one by the true theta."""
    wrong, source = Theta.from_vector(np.array(theta)), sources()[0]
    error, similarity = log_quality(source, wrong)
    frame = wrong.source_frame(SCANNER.source_to_cor_mm)
    return {
        "relative_error": error,
        "ssim": similarity,
        "ray_error_mm": ray_error(SCANNER, TRUE_FRAME, frame).rms_mm,
        "psi_error_deg": float(np.degrees(angle_difference(frame.psi_rad, TRUE_FRAME.psi_rad))),
        "cor_column_mm": frame.cor_column_mm,
        "image": log_image(source, wrong),
    }


def unit(case: Case) -> Unit:
    """Return the unit of one image."""
    return Unit(f"misspecified-{case.name}", run, {"theta": to_vector(case.theta).tolist()})


def units(plan: Plan) -> list[Unit]:  # noqa: ARG001 - as many as there are cases
    """List the units of all images, the true one included."""
    return [unit(case) for case in (*GALLERY, *ALONE)]


HEADER = ("relative error", "SSIM", "ray error, mm", "psi error, deg")


def _figures(found: Result) -> list[str]:
    return [
        f"{found['relative_error']:.3f}",
        f"{found['ssim']:.3f}",
        f"{found['ray_error_mm']:.2f}",
        f"{found['psi_error_deg']:+.1f}",
    ]


def _draw(images: dict[str, Result], path: Path) -> None:
    drawn = pictures.figure(8.4, 5.8)
    panels = drawn.subplots(2, 3).ravel()
    truth = images["f"]["image"]
    limits = (float(np.percentile(truth, 5.0)), float(np.percentile(truth, 99.8)))
    for axes, case in zip(panels, GALLERY, strict=True):
        title = f"({case.name}) {case.words}"
        pictures.show_image(axes, images[case.name]["image"], GRID.field_mm, limits, title)
    pictures.save_greys(drawn, path)


def section(plan: Plan, results: Results, folder: Path) -> Values:  # noqa: ARG001 - as many as there are cases
    """Draw the gallery; return its table, and the table of single parameters."""
    found = {case.name: results[unit(case).name] for case in (*GALLERY, *ALONE)}
    _draw(found, folder / "misspecification.png")
    blurred, lost = [found[name] for name in "bce"], [found[name] for name in "ad"]
    return {
        "source": sources()[0],
        "epsilon": f"{EPSILON_MM:.0f}",
        "blurred_rays": _range([one["ray_error_mm"] for one in blurred], "{:.0f}"),
        "lost_rays": _range([one["ray_error_mm"] for one in lost], "{:.0f}"),
        "blurred_ssim": _range([one["ssim"] for one in blurred], "{:.2f}"),
        "lost_ssim": _range([one["ssim"] for one in lost], "{:.2f}"),
        "true_column": f"{abs(TRUE_FRAME.cor_column_mm):.0f}",
        "lost_turn": f"{abs(found['a']['psi_error_deg']):.0f}",
        "gallery": pictures.table(
            ("picture", "theta", *HEADER),
            [[f"({case.name})", case.words, *_figures(found[case.name])] for case in GALLERY],
        ),
        "turned": f"{found['initial-angle']['ray_error_mm']:.2f}",
        "alone": pictures.table(
            ("what is wrong", *HEADER), [[case.words, *_figures(found[case.name])] for case in ALONE]
        ),
    }


def _range(values: list[float], form: str) -> str:
    least, most = form.format(min(values)), form.format(max(values))
    return least if least == most else f"{least} to {most}"


EXPERIMENT = Experiment("misspecification", units, section)
