"""Calibration, reconstruction and drift checks of scans in memory, for Python users and notebooks."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration import option_types
from sawmill_calibration.calibration.calibrate_scan import calibrate_scan
from sawmill_calibration.drift_checks.baselines import baselines_of, read_answers
from sawmill_calibration.drift_checks.drift_check import check_drift
from sawmill_calibration.failures import InputError, input_errors_translated, options_of
from sawmill_calibration.known_geometry import GivenGeometry, check_same_scanner, drawing_of
from sawmill_calibration.pictures.templating import html_of
from sawmill_calibration.reconstruction.reconstruct import reconstruct_in_memory
from sawmill_calibration.result_file import read_calibration as read_result
from sawmill_calibration.scans.scan import Scan, as_scanner, rows_in_file, rows_of_memory
from sawmill_calibration.scans.scan_rows import ScanRows, unreported
from sawmill_calibration.view_vectors import AnyGeometry, ImportedGeometry
from sawmill_contracts.calibrations import (
    CalibrationFile,
    CalibrationLimits,
    CalibrationOptions,
    CalibrationResult,
    PredictedRayError,
)
from sawmill_contracts.drifts import DriftResult
from sawmill_contracts.geometry import GivenTheta
from sawmill_contracts.reconstructions import ReconstructionOptions, ReconstructionResult
from sawmill_mill.next_step import step_alone
from sawmill_tomography.geometry.export import cil_arguments, odl_arguments
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FanViews, FloatArray
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.reconstruction.image_quality import ImageQuality, image_quality
from sawmill_vocabulary import ProgressCallback, Rotation, Scanner, SourceFrame, Theta, Verdict
from sawmill_vocabulary.calibration_arrays import CalibrationArrays

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """A calibration: the whole answer is `result`, properties give its most used fields.

    Attributes
    ----------
    result : CalibrationResult
        All fields of RESULT.json, with the same names (docs/look-up/http.md).
    arrays : callable, or None
        Computes the arrays of the report; None for a calibration that was read from a file.
    """

    result: CalibrationResult
    arrays: Callable[[], CalibrationArrays] | None = field(default=None, repr=False)

    @property
    def theta(self) -> Theta:
        """The five calibrated numbers."""
        return self.result.theta

    @property
    def source_frame(self) -> SourceFrame:
        """The geometry with the source on the axis."""
        return self.result.source_frame

    @property
    def scanner(self) -> Scanner:
        """The scanner that was calibrated, with the modules that were declared or found."""
        return as_scanner(self.result.scanner)

    @property
    def rotation(self) -> Rotation:
        """Sense of rotation, which way the view angles count."""
        return self.result.rotation

    @property
    def verdict(self) -> Verdict:
        """pass, watch or fail."""
        return self.result.verdict

    @property
    def reasons(self) -> list[str]:
        """Reasons why the verdict is not pass, and further remarks."""
        return self.result.reasons

    @property
    def predicted_ray_error_mm(self) -> PredictedRayError | None:
        """The ray error that the covariance predicts; None without error bars."""
        return self.result.predicted_ray_error_mm

    @property
    def scale_uncertainty_percent(self) -> float | None:
        """95 % uncertainty of the image's millimetres, per cent; None from an answer of an earlier version."""
        return self.result.scale_uncertainty_percent

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance (5, 5) of (psi, R, SDD, u_c, tau) in rad and mm; None without error bars."""
        return None if self.result.covariance is None else np.array(self.result.covariance)

    def vectors(self, angles_rad: FloatArray) -> FanBeamGeometry:
        """Return the rays of views at these angles, (views,) rad as the scan counts them."""
        return FanBeamGeometry(self.result.scanner, self.theta, self.rotation.apply(np.asarray(angles_rad, np.float64)))

    def to_astra(self, angles_rad: FloatArray) -> dict[str, Any]:
        """Return ASTRA's projection geometry, `fanflat_vec` in mm; refuse a detector of modules or on an arc."""
        views = self.vectors(angles_rad)
        return {"type": "fanflat_vec", "DetectorCount": len(views.borders_mm), "Vectors": views.astra_vectors()}

    def to_odl(self, angles_rad: FloatArray) -> dict[str, Any]:
        """Return the arguments of ODL's `FanBeamGeometry` as `sawmill export --to odl` writes them."""
        return odl_arguments(self.vectors(angles_rad))

    def to_cil(self, angles_rad: FloatArray) -> dict[str, Any]:
        """Return the arguments of CIL's `AcquisitionGeometry` as `sawmill export --to cil` writes them."""
        return cil_arguments(self.vectors(angles_rad))

    def save(self, path: str | Path) -> None:
        """Write RESULT.json as `sawmill calibrate --json` prints it; `read_calibration` reads the file."""
        document = CalibrationFile.of(self.result).model_dump(mode="json")
        Path(path).write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")

    def plot(self) -> "Figure":
        """Draw the report on one page, as report.png shows it.

        Raises
        ------
        InputError
            The calibration was read from a file.
        """
        if self.arrays is None:
            raise InputError("no-arrays", "this calibration was read from a file: calibrate its scan again to plot it")
        from sawmill_calibration.pictures.calibration_report import report_figure  # noqa: PLC0415 - matplotlib is slow

        return report_figure(self.result, self.arrays(), step_alone(self.result))

    def report(self, path: str | Path) -> None:
        """Write the report as one HTML page that prints on A4, as `sawmill report` does.

        A calibration that was read from a file has no pictures of the scan; the page says so.
        """
        from sawmill_calibration.pictures.report_page import About, report_html  # noqa: PLC0415 - few need it

        arrays = None if self.arrays is None else self.arrays()
        Path(path).write_text(report_html(self.result, About(), arrays), encoding="utf-8")

    def __repr__(self) -> str:
        error = self.predicted_ray_error_mm
        rays = "no error bars" if error is None else f"rays within {error.upper_95:.3f} mm (95 %)"
        numbers = ", ".join(f"{name}={value:.6g}" for name, value in vars(self.theta).items())
        return f"<Calibration: {self.verdict}, {rays}, {numbers}>"

    def _repr_html_(self) -> str:
        from sawmill_calibration.pictures.report_numbers import calibration_table  # noqa: PLC0415

        sentences = [*self.reasons, *self.result.adjustments]
        title = f"Calibration with {self.result.phantom}"
        return html_of(title, calibration_table(self.result), verdict=self.verdict, sentences=sentences)


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction:
    """A volume and how it was made.

    Attributes
    ----------
    volume : (slices, x, y) float32
        Values in `result.unit`. **The axes are not (z, y, x)**, as in scikit-image, tomopy and CIL:
        `volume.transpose(0, 2, 1)` has that order.
    result : ReconstructionResult
        Method, pixel size, unit, rows and remarks, with the field names of the service (docs/look-up/http.md).
    field_centre_mm : (x, y)
        Centre of the field, mm.
    """

    volume: NDArray[np.float32] = field(repr=False)
    result: ReconstructionResult
    field_centre_mm: tuple[float, float] = (0.0, 0.0)

    @property
    def image(self) -> NDArray[np.float32]:
        """Middle slice, (x, y) float32."""
        middle: NDArray[np.float32] = self.volume[len(self.volume) // 2]
        return middle

    def image_quality(self) -> ImageQuality:
        """Measure MTF and contrast as `sawmill image-quality` does; `InputError`: the slices show no plain disc."""
        with input_errors_translated():
            return image_quality(self.volume, self.result.pixel_mm)

    def plot(self, number: int | None = None) -> "Figure":
        """Draw one slice, counted from 0: the middle one by default, in the grey window of the volume."""
        from sawmill_calibration.pictures.figures import slice_figure  # noqa: PLC0415 - matplotlib is slow to import

        shown = range(len(self.volume))[len(self.volume) // 2 if number is None else number]
        row = range(*self.result.rows, self.result.row_step)[shown]
        return slice_figure(
            self.volume[shown],
            field_mm=self.result.pixel_mm * self.result.shape[1],
            centre_mm=self.field_centre_mm,
            unit=self.result.unit,
            window=self.result.value_range,
            title=f"slice {shown}, row {row} of the scan",
        )

    def __repr__(self) -> str:
        method = "" if self.result.method is None else f" by {self.result.method.name}"
        shape = " x ".join(map(str, self.result.shape))
        return f"<Reconstruction{method}: {shape} (slices, x, y), {self.result.pixel_mm:.4g} mm a pixel>"

    def _repr_html_(self) -> str:
        from sawmill_calibration.pictures.images import image_png  # noqa: PLC0415

        result = self.result
        rows = [
            ("method", "" if result.method is None else result.method.name),
            ("slices, x, y", " x ".join(map(str, result.shape))),
            ("pixel", f"{result.pixel_mm:.4g} mm"),
            ("views", result.views),
            ("unit", result.unit),
            ("time", f"{result.time_s:.3g} s"),
        ]
        png = image_png(self.image, pixel_mm=result.pixel_mm, unit=result.unit, window=result.value_range)
        return html_of("Reconstruction", rows, png=png)


@dataclass(frozen=True, eq=False, repr=False)
class Drift:
    """A drift check: the whole answer is `result`; properties give the most used fields.

    Attributes
    ----------
    result : DriftResult
        All fields of the answer, with the field names of the service (docs/look-up/http.md).
    """

    result: DriftResult

    @property
    def moved(self) -> bool:
        """True if any change is beyond three standard deviations."""
        return self.result.moved

    @property
    def within_tolerance(self) -> bool | None:
        """True if nothing moved beyond the tolerance; None where the scan is too uncertain to decide."""
        return self.result.within_tolerance

    @property
    def ray_change_mm(self) -> float:
        """RMS distance between the rays inside the log's disc, mm."""
        return self.result.ray_change_mm

    @property
    def reason(self) -> str:
        """Result, likely cause, and what to do."""
        return self.result.reason

    def plot(self) -> "Figure":
        """Draw each parameter's change with its uncertainty."""
        from sawmill_calibration.pictures.figures import drift_figure  # noqa: PLC0415 - matplotlib is slow to import

        return drift_figure(self.result)

    def __repr__(self) -> str:
        return f"<Drift: {self.reason}>"

    def _repr_html_(self) -> str:
        result, deviation = self.result, self.result.change_standard_deviation
        verdicts = {True: "within tolerance", False: "not within tolerance", None: "too uncertain to decide"}
        change = result.change
        rows = [
            ("rays", f"{result.ray_change_mm:.3g} ± {result.ray_change_uncertainty_mm:.2g} mm"),
            ("COR on the detector, mm", f"{change.cor_column_mm:+.3g} ± {deviation.cor_column_mm:.2g}"),
            ("tilt, rad", f"{change.tilt_rad:+.3g} ± {deviation.tilt_rad:.2g}"),
        ]
        if (zero := result.baseline) is not None:
            since, spread = zero.change.cor_column_mm, zero.change_standard_deviation.cor_column_mm
            rows.append((f"since {zero.checks} first logs: COR, mm", f"{since:+.3g} ± {spread:.2g}"))
        sentences = [result.reason, *(f"not seen: {what}" for what in result.not_seen)]
        if result.reference == "given-geometry":
            return html_of("Centre of rotation", rows, sentences=sentences)
        return html_of("Drift", rows, verdict=verdicts[result.within_tolerance], sentences=sentences)


def read_calibration(path: str | Path) -> Calibration:
    """Read a calibration that `save`, `sawmill calibrate --json` or the service wrote.

    Parameters
    ----------
    path : str or Path
        RESULT.json or result.h5.

    Raises
    ------
    ValueError
        `InputError`: the file holds no calibration.
    """
    return Calibration(read_result(Path(path)))


def calibrate(
    scan: Scan,
    phantom: Phantom | str | Path,
    *,
    phantom_width_mm: float | None = None,
    tolerance_mm: float = 0.1,
    scale_tolerance_percent: float = 0.5,
    log_radius_mm: float | None = None,
    on_progress: ProgressCallback = unreported,
    **options: Unpack[option_types.CalibrationOptions],
) -> Calibration:
    """Find theta from a scan of a phantom, as `sawmill calibrate` does.

    Parameters
    ----------
    scan : Scan
        Scan of the phantom.
    phantom : Phantom, str or Path
        A phantom, the name of a built-in one, or the path of a drawing (JSON) or of a picture (PNG).
    phantom_width_mm : float, optional
        Whole width of the picture, mm; for a picture alone.
    tolerance_mm : float
        Limit of the predicted ray error, mm. The calibration passes where the error is below the limit with 95 %.
    scale_tolerance_percent : float
        Limit of the 95 % uncertainty of the image's millimetres, per cent.
    log_radius_mm : float, optional
        Radius of the disc in which ray errors are counted, mm. Default: the phantom's, at most 150.
    on_progress : callable, optional
        Called with an object that has the `fraction` of the work that is done, from 0 to 1, and its `stage`.
    **options
        Further options of a calibration, listed in docs/look-up/python.md#options-of-calibrate.

    Raises
    ------
    ValueError
        `InputError`: an option is wrong, or the scan determines no geometry.
    """
    chosen = options_of(CalibrationOptions, options)
    tolerances = {"tolerance_mm": tolerance_mm, "scale_tolerance_percent": scale_tolerance_percent}
    limits = options_of(CalibrationLimits, {**tolerances, "log_radius_mm": log_radius_mm})
    if chosen.log_rows is not None:
        chosen = chosen.model_copy(update={"log_rows": rows_in_file(scan, chosen.log_rows)})
    with input_errors_translated():
        rows = rows_of_memory(scan, rows=chosen.rows, views=chosen.views, on_progress=on_progress)
        made = calibrate_scan(rows, drawing_of(phantom, phantom_width_mm), chosen, limits)
    return Calibration(made.result(), made.arrays)


def reconstruct(
    scan: Scan,
    geometry: Calibration | Theta | FanViews,
    *,
    rotation: Rotation | str = Rotation.AS_GIVEN,
    on_progress: ProgressCallback = unreported,
    **options: Unpack[option_types.ReconstructionOptions],
) -> Reconstruction:
    """Reconstruct each row of a scan into arrays, as `sawmill reconstruct` does into a file.

    Parameters
    ----------
    scan : Scan
        Scan of a log.
    geometry : Calibration, Theta or FanViews
        Geometry of the scanner that made the scan; views replace the scan's angles.
    rotation : str
        Sense of rotation for a Theta, `as-given` or `reversed`: which way the angles count. A calibration has its own.
    on_progress : callable, optional
        Called with an object that has the `fraction` of the work that is done, from 0 to 1, and its `stage`.
    **options
        Further options of a reconstruction, listed in docs/look-up/python.md#options-of-reconstruct.

    Raises
    ------
    ValueError
        `InputError` or `GeometryError`: an option is wrong, or the geometry is not the scan's.
    """
    chosen = options_of(ReconstructionOptions, options)
    with input_errors_translated():
        rows = rows_of_memory(scan, rows=chosen.rows, views=chosen.views)
        volume, result = reconstruct_in_memory(*_geometry(rows, geometry, rotation), chosen, on_progress)
    return Reconstruction(volume, result, chosen.field_centre_mm)


def drift(
    scan: Scan,
    calibration: Calibration | Theta | FanViews,
    *,
    rotation: Rotation | str = Rotation.AS_GIVEN,
    baseline: Sequence[Drift | str | Path] = (),
    tolerance_mm: float = 0.5,
) -> Drift:
    """Find what moved since a calibration, from any scan of a log with 8 views or more, as `sawmill drift` does.

    Parameters
    ----------
    scan : Scan
        Scan of a log.
    calibration : Calibration, Theta or FanViews
        Geometry to compare with. For a Theta of nominal distances, or views that turn about one axis, the answer is
        where the centre of rotation is, and `result.theta` is the geometry to reconstruct with.
    rotation : str
        Sense of rotation for a Theta, `as-given` or `reversed`: which way the angles count. A calibration has its own.
    baseline : sequence of Drift, or of paths
        Answers of earlier drift checks, whose mean is the zero of the change: results of this function, or files that
        `sawmill drift --json` or the service wrote. Three checks or more against this calibration, each of another
        scan; only checks by this scan's method count.
    tolerance_mm : float
        RMS ray distance up to which the scanner counts as not moved, mm.

    Raises
    ------
    ValueError
        `InputError`: the calibration is of another scanner, the scan's views cannot be compared, or an answer is not
        usable for a baseline.
    """
    if isinstance(baseline, (str, Path, Drift)):
        raise InputError("options", f"baseline must be a list of answers, not one of them: {baseline!r}")
    with input_errors_translated():
        rows, known = _geometry(rows_of_memory(scan), calibration, rotation)
        baselines = baselines_of(_named_answers(baseline), known, scan.sha256) if baseline else ()
        result = check_drift(rows, known, tolerance_mm=tolerance_mm, baselines=baselines)
    return Drift(result.ended(datetime.now(UTC)))


def _named_answers(answers: Sequence[Drift | str | Path]) -> Iterator[tuple[str, DriftResult]]:
    for number, answer in enumerate(answers):
        if isinstance(answer, Drift):
            yield f"baseline[{number}]", answer.result
        else:
            yield from read_answers([Path(answer)])


def _geometry(
    rows: ScanRows, geometry: Calibration | Theta | FanViews, rotation: Rotation | str
) -> tuple[ScanRows, AnyGeometry]:
    """Return the rows, with the angles of given views, and what the geometry is known by."""
    if isinstance(geometry, FanViews):
        return ImportedGeometry.of(geometry, rows)
    if not isinstance(geometry, Calibration):
        return rows, GivenGeometry(rows.scanner, options_of(GivenTheta, vars(geometry)), Rotation(rotation))
    check_same_scanner(geometry.result.scanner, rows.scanner)
    return rows, geometry.result
