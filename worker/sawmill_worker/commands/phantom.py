"""`sawmill phantom`: predicted precision of phantoms, and their drawings."""

from pathlib import Path

from sawmill_calibration.calibration.plan import PlanInput, run_plan
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.plans import PlanOptions, PlanResult
from sawmill_vocabulary import Theta
from sawmill_worker.commands.phantom_options import PhantomSource
from sawmill_worker.commands.phantoms import drawing_of
from sawmill_worker.pictures.phantom_drawing import phantom_svg


def plan_phantoms(
    phantoms: list[PhantomSource],
    options: list[PlanOptions],
    *,
    scanner: ScannerConstants,
    theta: Theta,
    log_radius_mm: float | None,
) -> list[PlanResult]:
    """Plan with each phantom and each number of views, the phantoms in the given order."""
    inputs = [PlanInput(drawing_of(phantom), scanner, theta, log_radius_mm) for phantom in phantoms]
    return [run_plan(phantom, scan) for phantom in inputs for scan in options]


def draw_phantom(phantom: PhantomSource, output: Path) -> None:
    """Write a phantom as SVG, at full size."""
    output.write_text(phantom_svg(drawing_of(phantom)), encoding="utf-8")
