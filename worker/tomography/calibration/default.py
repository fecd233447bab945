"""The calibration that users get: a search for the valley, least squares to its bottom, over the four hypotheses."""

import time
from dataclasses import dataclass

import numpy as np

from worker.tomography import analytic
from worker.tomography.analytic import PARAMETERS, DetectorCells
from worker.tomography.calibration.calibration import (
    Calibration,
    CalibrationError,
    HypothesisReport,
    SearchReport,
    choose_theta,
    theta_deviation,
)
from worker.tomography.calibration.refine import MODEL, ONE, Fit, SinogramData, refine
from worker.tomography.calibration.search import CoarseMisfit, Progress, SearchOutcome, coarse_data, search, search_box
from worker.tomography.calibration.verdict import judge
from worker.tomography.geometry import (
    FloatArray,
    GeometryError,
    Handedness,
    Rotation,
    Scanner,
    SourceFrame,
    ThetaBounds,
)
from worker.tomography.phantom import Phantom
from worker.tomography.ray_error import predicted_ray_error

# A fit that leaves more than this of the sinogram unexplained has not found the phantom: the right phantom seen
# from the wrong side leaves 0.11 to 0.3, an empty scan 1.
NOT_FOUND = 0.25
# Hypotheses whose coarse residual comes this close to the best one's are fitted on all the data and compared again.
CONTENDER = 3.0

Hypothesis = tuple[Handedness, Rotation]


@dataclass(frozen=True)
class CalibrationTask:
    """What is asked.

    Attributes
    ----------
    sinogram : (views, detector) float
        Line integrals in any unit: gain and background are free.
    angles_rad : (views,) float64
        Every view's own angle.
    bounds : ThetaBounds or None
        Where theta is searched; None searches wherever the phantom can be seen.
    handedness, rotation
        None tries both.
    rays_per_cell : int or None
        Rays a cell in the model; None averages over the cell, as a real detector does.
    """

    scanner: Scanner
    phantom: Phantom
    sinogram: FloatArray
    angles_rad: FloatArray
    bounds: ThetaBounds | None = None
    handedness: Handedness | None = None
    rotation: Rotation | None = None
    rays_per_cell: int | None = None
    log_radius_mm: float = 150.0
    tolerance_mm: float = 0.1

    def __post_init__(self) -> None:
        """Refuse data that do not belong together."""
        sinogram = np.ascontiguousarray(self.sinogram, np.float64)
        angles = np.ascontiguousarray(self.angles_rad, np.float64)
        if sinogram.ndim != 2 or sinogram.shape[1] != self.scanner.num_detector_pixels:
            raise CalibrationError(
                "wrong-shape",
                f"the sinogram has shape {sinogram.shape}, but the scanner has {self.scanner.num_detector_pixels} "
                "detector cells: it must be (views, detector)",
            )
        if angles.shape != sinogram.shape[:1]:
            raise CalibrationError(
                "angles-mismatch",
                f"there are {sinogram.shape[0]} views and {angles.size} angles: each view needs its own",
            )
        if sinogram.shape[0] < 3:
            raise CalibrationError("too-few-views", f"{sinogram.shape[0]} views cannot calibrate: give at least 3")
        if not np.isfinite(sinogram).all() or not np.isfinite(angles).all():
            raise CalibrationError("not-finite", "the sinogram or its angles hold NaN or infinite values: remove them")
        if np.ptp(sinogram) == 0.0:
            raise CalibrationError(
                "flat-scan", f"every value of the sinogram is {sinogram[0, 0]:.6g}: nothing was scanned"
            )
        object.__setattr__(self, "sinogram", sinogram)
        object.__setattr__(self, "angles_rad", angles)

    @property
    def phantoms(self) -> dict[Handedness, Phantom]:
        """The phantom as each allowed handedness sees it."""
        seen = {Handedness.AS_DRAWN: self.phantom, Handedness.FROM_BEHIND: self.phantom.mirrored()}
        return {h: p for h, p in seen.items() if self.handedness in {None, h}}

    @property
    def rotations(self) -> tuple[Rotation, ...]:
        """The allowed senses of rotation."""
        return tuple(r for r in Rotation if self.rotation in {None, r})

    def full_data(self, rotation: Rotation) -> SinogramData:
        """All views and cells, as this sense of rotation reads them."""
        cells = DetectorCells.of(self.scanner)
        return SinogramData(self.sinogram, rotation.apply(self.angles_rad), cells, self.rays_per_cell)


def calibrate(task: CalibrationTask, *, seed: int = 7, progress: Progress | None = None) -> Calibration:
    """Find the geometry from one scan of the phantom.

    Raises
    ------
    CalibrationError
        If no geometry explains the scan; its message says what to look at.
    """
    started = time.perf_counter()
    outcome, misfit = _find_valley(task, seed, progress)
    found = time.perf_counter()
    fits = _coarse_fits(misfit, outcome)
    report = SearchReport(
        "differential-evolution",
        seed,
        outcome.evaluations,
        outcome.generations,
        outcome.best_value,
        outcome.converged,
        outcome.message,
    )
    return conclude(task, fits, report, started=started, found=found)


def _find_valley(task: CalibrationTask, seed: int, progress: Progress | None) -> tuple[SearchOutcome, CoarseMisfit]:
    sinogram, angles, cells = coarse_data(task.scanner, task.sinogram, task.angles_rad)
    misfit = CoarseMisfit(task.phantoms, task.rotations, sinogram, angles, cells)
    try:
        box = search_box(task.scanner, task.bounds, task.phantom)
    except GeometryError as error:
        raise CalibrationError("no-geometry", str(error)) from error
    return search(misfit, box, seed=seed, progress=progress), misfit


def _coarse_fits(misfit: CoarseMisfit, outcome: SearchOutcome) -> dict[Hypothesis, Fit]:
    fits = {}
    for (handedness, rotation), candidate in outcome.best.items():
        data = SinogramData(misfit.sinogram, rotation.apply(misfit.angles_rad), misfit.cells)
        fit = refine(misfit.phantoms[handedness], data, candidate.frame)
        if fit is not None:
            fits[handedness, rotation] = fit
    return fits


def conclude(
    task: CalibrationTask, coarse: dict[Hypothesis, Fit], search_report: SearchReport, *, started: float, found: float
) -> Calibration:
    """From one coarse fit a hypothesis to the complete answer."""
    fits = _full_fits(task, coarse)
    ranked = sorted(fits.items(), key=lambda item: item[1].relative_residual)
    if not ranked or not ranked[0][1].relative_residual < NOT_FOUND:
        unexplained = f"{ranked[0][1].relative_residual:.0%}" if ranked else "all"
        raise CalibrationError(
            "phantom-not-found",
            f"the phantom {task.phantom.name!r} was not found: the best geometry leaves {unexplained} of the sinogram "
            "unexplained; check that the scan (and its rows) shows this phantom, its size, the angles and the "
            "scanner's constants",
        )
    (handedness, rotation), free = ranked[0]
    phantom, data = task.phantoms[handedness], task.full_data(rotation)
    fit, fixed = _with_theta(task, phantom, data, free)
    refined = time.perf_counter()
    model = analytic.project(
        phantom,
        data.cells,
        fit.frame,
        data.angles_rad,
        position_mm=fit.position_mm,
        rays_per_cell=data.rays_per_cell,
    )
    inflation = residual_inflation(phantom, data, fit)
    covariance = fit.covariance[:5, :5] * inflation
    theta, twin = choose_theta(task.scanner, fit.frame, task.bounds)
    predicted = predicted_ray_error(task.scanner, fit.frame, covariance, radius_mm=task.log_radius_mm)
    hypotheses = tuple(HypothesisReport(h, r, f.relative_residual) for (h, r), f in ranked)
    verdict, reasons = judge(
        predicted_mm=predicted.rms_mm,
        tolerance_mm=task.tolerance_mm,
        fit=fit,
        inflation=inflation,
        hypotheses=hypotheses,
        samples=data.sinogram.size,
        theta_in_bounds=task.bounds is None or task.bounds.contain(theta),
        unconstrained_mm=free.frame.source_distance_mm if fixed else None,
        source_to_cor_mm=task.scanner.source_to_cor_mm,
    )
    deviation = theta_deviation(task.scanner, fit.frame, theta, covariance)
    ended = time.perf_counter()
    return Calibration(
        scanner=task.scanner,
        phantom=task.phantom,
        frame=fit.frame,
        theta=theta,
        theta_twin=twin,
        covariance=covariance,
        theta_deviation=deviation,
        source_distance_fixed=fixed,
        unconstrained_source_distance_mm=free.frame.source_distance_mm,
        scale_uncertainty_mm=task.phantom.size_tolerance * fit.frame.source_distance_mm,
        predicted_ray_error=predicted,
        log_radius_mm=task.log_radius_mm,
        inflation=inflation,
        handedness=handedness,
        rotation=rotation,
        hypotheses=hypotheses,
        position_mm=fit.position_mm,
        gain=fit.gain,
        offset=fit.offset,
        residual_rms=fit.residual_rms,
        relative_residual=fit.relative_residual,
        model=fit.gain * model + fit.offset,
        residual=task.sinogram - fit.gain * model - fit.offset,
        verdict=verdict,
        reasons=reasons,
        search=search_report,
        seconds={
            "total": ended - started,
            "search": found - started,
            "refine": refined - found,
            "uncertainty": ended - refined,
        },
    )


def _full_fits(task: CalibrationTask, coarse: dict[Hypothesis, Fit]) -> dict[Hypothesis, Fit]:
    """Fit on all the data what may have won; keep the coarse fit of what cannot."""
    least = min((fit.relative_residual for fit in coarse.values()), default=0.0)
    fits = {}
    for (handedness, rotation), start in coarse.items():
        fit: Fit | None = start
        if start.relative_residual <= CONTENDER * least:
            data = task.full_data(rotation)
            fit = refine(task.phantoms[handedness], data, start.frame, position_mm=start.position_mm)
        if fit is not None:
            fits[handedness, rotation] = fit
    return fits


def _with_theta(task: CalibrationTask, phantom: Phantom, data: SinogramData, fit: Fit) -> tuple[Fit, bool]:
    """The fit itself, or the one with R = r_S where the free one has no theta (design page, section 3)."""
    r_s = task.scanner.source_to_cor_mm
    if fit.frame.source_distance_mm >= r_s:
        return fit, False
    ratio = r_s / fit.frame.source_distance_mm
    start = SourceFrame.from_vector(fit.frame.to_vector() * [1.0, ratio, ratio, 1.0, 1.0])
    held = refine(phantom, data, start, position_mm=fit.position_mm, fixed_source_distance=True)
    if held is None:
        raise CalibrationError(
            "no-geometry",
            f"the scan asks for a source at {fit.frame.source_distance_mm:.4g} mm, nearer than source_to_cor_mm "
            f"{r_s:.6g}: check source_to_cor_mm and the phantom's size",
        )
    return held, True


def residual_inflation(phantom: Phantom, data: SinogramData, fit: Fit) -> float:
    """How much wider the parameters scatter than white noise of the same RMS would make them; at least 1.

    The views' scores (derivative times residual) are compared with what independent cells would give: the mean
    eigenvalue of the cluster-robust covariance against the classical one (Liang and Zeger 1986), views as clusters.
    """
    grams = analytic.gram(
        phantom,
        data.cells,
        fit.frame,
        data.angles_rad,
        data.sinogram,
        position_mm=fit.position_mm,
        rays_per_cell=data.rays_per_cell,
    )
    free = [i for i in range(PARAMETERS) if fit.covariance[i, i] > 0.0]
    columns = [*(free), MODEL, ONE]
    weights = np.zeros(PARAMETERS + 3)
    weights[MODEL], weights[ONE], weights[-1] = -fit.gain, -fit.offset, 1.0
    scores = grams[:, columns, :] @ weights
    views, unknowns = scores.shape
    if views <= unknowns:
        return 1.0
    bread = grams.sum(axis=0)[np.ix_(columns, columns)]
    scale = 1.0 / np.sqrt(np.diag(bread))
    inverse = np.linalg.pinv(bread * np.outer(scale, scale), hermitian=True)
    meat = (scores * scale).T @ (scores * scale) * views / (views - unknowns)
    noise = fit.residual_rms**2
    if noise <= 0.0:
        return 1.0
    scatter = float(np.trace(inverse @ meat))
    return float(max(1.0, scatter / (unknowns * noise)))
