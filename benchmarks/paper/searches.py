"""Calibrations by the product's two methods, and by the published pipeline itself, with what became of a log."""

from functools import cache
from typing import Literal

import numpy as np
from scanners import SCANNER
from scans import ANGLES, TRUE_FRAME, Source, log_quality, published_l_phantom, simulated, sources

from paper.experiment import Plan, Result, Unit
from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.paper import PaperSettings, calibrate_as_published
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame, Theta, angle_difference, to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import BUILT_IN
from sawmill_vocabulary import Handedness, Rotation

NOISE = 0.02
MadeOf = Literal["published", "simulated", "exact"]


def default_source() -> Source:
    """Return the published data's name where they are present, else the simulated data's."""
    return sources()[0]


@cache
def phantom_scan(phantom: str, made_of: MadeOf, noise_seed: int) -> FloatArray:
    """Return all 360 views of a built-in phantom: published, simulated with 2 % noise, or simulated exactly."""
    if made_of == "published":
        return published_l_phantom()
    return simulated(BUILT_IN[phantom], noise=NOISE if made_of == "simulated" else 0.0, seed=noise_seed)


def every_so_many(views: int) -> slice:
    """Return the slice that takes this number of the 360 views, each with its own angle."""
    return slice(None, None, len(ANGLES) // views)


def binned(scanner: Scanner, sinogram: FloatArray, by: int) -> tuple[Scanner, FloatArray]:
    """Average neighbouring cells; return the coarser scanner and its sinogram."""
    cells = scanner.num_detector_pixels // by
    coarse = Scanner(scanner.source_to_cor_mm, cells, scanner.detector_pitch_mm * by)
    return coarse, sinogram.reshape(len(sinogram), cells, by).mean(axis=2)


def scores(theta: Theta, frame: SourceFrame, rotation: Rotation = Rotation.AS_GIVEN) -> Result:
    """Compute the distance of a geometry from the true one, by every measure that the page uses."""
    result: Result = {
        "theta": to_vector(theta).tolist(),
        "frame": to_vector(frame).tolist(),
        "ray_error_mm": ray_error(SCANNER, TRUE_FRAME, frame).rms_mm,
        "psi_error_deg": float(np.degrees(angle_difference(frame.psi_rad, TRUE_FRAME.psi_rad))),
    }
    for source in sources():
        error, similarity = log_quality(source, theta, rotation)
        result[source] = {"relative_error": error, "ssim": similarity}
    return result


def _described(found: CalibrationOutcome) -> Result:
    return scores(found.theta, found.frame, found.rotation) | {
        "handedness": str(found.handedness),
        "rotation": str(found.rotation),
        "evaluations": found.search.evaluations,
        "verdict": found.judgement.verdict,
    }


def run_default(phantom: str, made_of: MadeOf, views: int, seed: int) -> Result:
    """Run the product's calibration."""
    take = every_so_many(views)
    task = CalibrationTask(SCANNER, BUILT_IN[phantom], phantom_scan(phantom, made_of, seed)[take], ANGLES[take])
    found = calibrate(task, seed=seed)
    result = _described(found)
    if found.findings.error_bars is not None:
        result["covariance"] = found.findings.error_bars.covariance.values.tolist()
        result["predicted_ray_error_mm"] = found.findings.error_bars.predicted_ray_error.rms_mm
    if found.theta_twin is not None:
        result["twin"] = to_vector(found.theta_twin).tolist()
        twin_frame = found.theta_twin.source_frame(SCANNER.source_to_cor_mm)
        result["twin_ray_error_mm"] = ray_error(SCANNER, found.frame, twin_frame).rms_mm
    return result


def run_paper(
    phantom: str, made_of: MadeOf, views: int, seed: int, image_size: int, cells_binned: int, max_generations: int
) -> Result:
    """Run the published search as the product has it; noise and search have the same seed."""
    take = every_so_many(views)
    scanner, sinogram = binned(SCANNER, phantom_scan(phantom, made_of, seed)[take], cells_binned)
    found = calibrate_as_published(
        CalibrationTask(scanner, BUILT_IN[phantom], sinogram, ANGLES[take]),
        options=PaperSettings(image_size=image_size, max_generations=max_generations),
        seed=seed,
    )
    return _described(found)


def run_in_odl(phantom: str, made_of: MadeOf, views: int, seed: int) -> Result:
    """Run the published pipeline, put together from the paper with ODL."""
    # ODL takes seconds to import, and only the full run needs it.
    from published_pipeline import PublishedObjective, search  # noqa: PLC0415

    take = every_so_many(views)
    objective = PublishedObjective(SCANNER, BUILT_IN[phantom], phantom_scan(phantom, made_of, seed)[take])
    outcome = search(objective, seed)
    # ODL's cell-centred partition puts the first view half a step beyond alpha0.
    theta = theta_with_first_angle(Theta.from_vector(outcome.x), 0.5 * 360.0 / views - float(np.degrees(ANGLES[0])))
    frame = theta.source_frame(SCANNER.source_to_cor_mm)
    return scores(theta, frame) | {
        "handedness": str(Handedness.AS_DRAWN),
        "rotation": str(Rotation.AS_GIVEN),
        "evaluations": int(outcome.nfev),
        "verdict": "watch",
    }


def theta_with_first_angle(theta: Theta, further_deg: float) -> Theta:
    """Return theta with its initial angle turned by this number of degrees."""
    vector = to_vector(theta)
    vector[0] += np.radians(further_deg)
    return Theta.from_vector(vector)


def default_unit(phantom: str, made_of: MadeOf, views: int, seed: int) -> Unit:
    """Return the unit of one run of the `default` method."""
    settings = {"phantom": phantom, "made_of": made_of, "views": views, "seed": seed}
    return Unit(f"default-{phantom}-{made_of}-{views}-{seed}", run_default, settings, 1.0)


def paper_unit(plan: Plan, phantom: str, made_of: MadeOf, views: int, seed: int) -> Unit:
    """Return the unit of one run of the `paper` method, its cells averaged where the views are dense."""
    dense = views > 2 * plan.sparse_views
    size = plan.dense_image_size if dense else plan.sparse_image_size
    settings = {
        "phantom": phantom,
        "made_of": made_of,
        "views": views,
        "seed": seed,
        "image_size": size,
        "cells_binned": plan.dense_binned if dense else 1,
        "max_generations": plan.max_generations,
    }
    return Unit(f"paper-{phantom}-{made_of}-{views}-{size}px-{seed}", run_paper, settings, 24.0 if dense else 5.0)


def odl_unit(phantom: str, made_of: MadeOf, views: int, seed: int) -> Unit:
    """Return the unit of one run of the published pipeline in ODL."""
    settings = {"phantom": phantom, "made_of": made_of, "views": views, "seed": seed}
    return Unit(f"odl-{phantom}-{made_of}-{views}-{seed}", run_in_odl, settings, 1200.0 if views > 40 else 80.0)
