"""Calibration from all views and from few: why the product's sparse calibration is not turned."""

from pathlib import Path

import numpy as np
from scanners import SCANNER
from scans import ANGLES, GRID, TRUE_FRAME, log_image, log_quality, reference_image, sources

from paper import pictures
from paper.experiment import Experiment, Plan, Result, Results, Unit, Values
from paper.searches import MadeOf, default_source, every_so_many, phantom_scan
from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import TAU, FloatArray, angle_difference
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE

OWN, COUNTED = "own", "counted"


def counted_angles(views: int) -> FloatArray:
    """Return the angles of a program that knows only the number of views: the middles of equal parts of a turn."""
    return (np.arange(views) + 0.5) * TAU / views


def run(views: int, angles: str, made_of: MadeOf) -> Result:
    """Calibrate with every view's own angle or with counted ones, and reconstruct the log from all 360 views."""
    take = every_so_many(views)
    given = ANGLES[take] if angles == OWN else counted_angles(views)
    found = calibrate(CalibrationTask(SCANNER, L_SHAPE, phantom_scan("l-shape", made_of, 0)[take], given), seed=0)
    source = sources()[0]
    error, similarity = log_quality(source, found.theta, found.rotation)
    return {
        "psi_error_deg": float(np.degrees(angle_difference(found.frame.psi_rad, TRUE_FRAME.psi_rad))),
        "ray_error_mm": ray_error(SCANNER, TRUE_FRAME, found.frame).rms_mm,
        "relative_error": error,
        "ssim": similarity,
        "image": log_image(source, found.theta, found.rotation),
    }


def unit(views: int, angles: str) -> Unit:
    """Return the unit of one calibration."""
    return Unit(f"sparse-{views}-{angles}", run, {"views": views, "angles": angles, "made_of": default_source()})


def units(plan: Plan) -> list[Unit]:
    """List the units of both kinds of angles at every number of views."""
    return [unit(views, angles) for views in plan.compared_views for angles in (OWN, COUNTED)]


HEADER = (
    "views",
    "angles",
    "psi error, deg",
    "expected, deg",
    "ray error, mm",
    "log's relative error",
    "log's SSIM",
)


def _degrees(angles: FloatArray) -> str:
    """Format the first two angles in degrees."""
    return ", ".join(f"{angle:.4g}" for angle in np.degrees(angles[:2]))


def section(plan: Plan, results: Results, folder: Path) -> Values:
    """Draw the log with three calibrations, and return the turn by counted angles."""
    sparse = plan.sparse_views
    drawn = pictures.figure(8.4, 3.2)
    panels = drawn.subplots(1, 3)
    truth = reference_image(sources()[0])
    limits = (float(np.percentile(truth, 5.0)), float(np.percentile(truth, 99.8)))
    for axes, wanted, title in zip(
        panels,
        (unit(plan.dense_views, OWN), unit(sparse, OWN), unit(sparse, COUNTED)),
        (f"{plan.dense_views} views", f"{sparse} views, own angles", f"{sparse} views, counted angles"),
        strict=True,
    ):
        pictures.show_image(axes, results[wanted.name]["image"], GRID.field_mm, limits, title)
    pictures.save_greys(drawn, folder / "sparse.png")
    rows = []
    for views in plan.compared_views:
        for angles in (OWN, COUNTED):
            found = results[unit(views, angles).name]
            expected = np.degrees(ANGLES[0] - counted_angles(views)[0]) if angles == COUNTED else 0.0
            turned = [f"{found['psi_error_deg']:+.3f}", f"{expected:+.3f}"]
            log = [f"{found['relative_error']:.4f}", f"{found['ssim']:.4f}"]
            rows.append([str(views), angles, *turned, f"{found['ray_error_mm']:.3f}", *log])
    own, counted = results[unit(sparse, OWN).name], results[unit(sparse, COUNTED).name]
    return {
        "source": default_source(),
        "sparse": str(sparse),
        "own_angles": _degrees(ANGLES[every_so_many(sparse)]),
        "counted_angles": _degrees(counted_angles(sparse)),
        "counted_psi": f"{counted['psi_error_deg']:+.2f}",
        "own_psi": f"{own['psi_error_deg']:+.3f}",
        "counted_error": f"{counted['ray_error_mm']:.3f}",
        "own_error": f"{own['ray_error_mm']:.3f}",
        "table": pictures.table(HEADER, rows),
    }


EXPERIMENT = Experiment("sparse", units, section)
