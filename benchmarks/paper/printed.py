"""The paper's printed results (arXiv 2206.14444), digit by digit, and the errors of its rounded theta here."""

import itertools
from dataclasses import dataclass

import numpy as np
from scanners import SCANNER
from scans import TRUE_FRAME, log_quality, sources

from paper.experiment import Result
from sawmill_tomography.geometry.geometry import FloatArray, Theta, angle_difference
from sawmill_tomography.geometry.ray_error import ray_error

# Half of the last digit of alpha0, r_D, h_S, h_D and alpha_D.
HALF_DIGIT = np.array([0.005, 0.5, 0.5, 0.5, 0.005])


@dataclass(frozen=True)
class PrintedRun:
    """A row of Table 1: alpha0 (rad), r_D, h_S, h_D (mm), alpha_D; the log's relative error and SSIM."""

    theta: tuple[str, str, str, str, str]
    relative_error: str
    ssim: str

    @property
    def vector(self) -> FloatArray:
        """Theta as numbers, (5,)."""
        return np.array([float(number) for number in self.theta])


# Table 1, by phantom; relative error and SSIM are of the log's FBP from all views, against that with the true theta.
TABLE_1: dict[str, tuple[PrintedRun, ...]] = {
    "l-shape": (
        PrintedRun(("2.45", "743", "425", "135", "0.40"), "0.073", "0.829"),
        PrintedRun(("2.73", "678", "157", "-89", "0.11"), "0.064", "0.847"),
        PrintedRun(("3.00", "621", "-81", "-268", "-0.16"), "0.072", "0.796"),
        PrintedRun(("2.60", "670", "266", "-8", "0.16"), "0.083", "0.785"),
        PrintedRun(("2.89", "641", "21", "-192", "-0.08"), "0.083", "0.764"),
    ),
    "rectangle-with-hole": (
        PrintedRun(("2.79", "641", "-134", "-89", "-0.02"), "0.081", "0.693"),
        PrintedRun(("3.16", "593", "-223", "-370", "-0.34"), "0.065", "0.834"),
        PrintedRun(("2.90", "638", "8", "-204", "-0.04"), "0.122", "0.709"),
        PrintedRun(("2.57", "699", "305", "28", "0.24"), "0.077", "0.789"),
        PrintedRun(("2.58", "716", "291", "22", "0.27"), "0.045", "0.928"),
    ),
}


def shift_range(phantom: str) -> str:
    """Format the least and largest source shift of a phantom's printed runs, as in `-81 and 425 mm`."""
    shifts = sorted((run.theta[2] for run in TABLE_1[phantom]), key=float)
    return f"{shifts[0]} and {shifts[-1]} mm"


def errors_of(theta: FloatArray) -> tuple[float, float]:
    """Compute ray error in mm and psi error in degrees of a theta (5,) against the truth."""
    frame = Theta.from_vector(theta).source_frame(SCANNER.source_to_cor_mm)
    psi = float(np.degrees(angle_difference(frame.psi_rad, TRUE_FRAME.psi_rad)))
    return ray_error(SCANNER, TRUE_FRAME, frame).rms_mm, psi


def judge(theta: list[float]) -> Result:
    """Compare a printed theta with the truth: as printed, and at the 32 corners of the rounding interval."""
    printed = np.array(theta)
    corners = [errors_of(printed + HALF_DIGIT * np.array(signs)) for signs in itertools.product((-1.0, 1.0), repeat=5)]
    rays, psi = errors_of(printed)
    return {
        "ray_error_mm": rays,
        "psi_error_deg": psi,
        "ray_error_range_mm": [min(ray for ray, _ in corners), max(ray for ray, _ in corners)],
        "psi_error_range_deg": [min(turn for _, turn in corners), max(turn for _, turn in corners)],
        "relative_error": log_quality(sources()[0], Theta.from_vector(printed))[0],
    }
