"""Readable numbers of a calibration's report and their table: angles in degrees, with radians next to them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from sawmill_contracts.calibrations import CalibrationResult, Comparison, FoundGeometry, LogCheck, PhantomPose
from sawmill_contracts.phantoms import PhantomDrawing, SizeMeasurement
from sawmill_vocabulary import Shape, Theta
from sawmill_vocabulary.messages import ENGLISH, N_, Reader
from sawmill_vocabulary.uncertainty import SOURCES, ContrastLoss

NOT_KNOWN = N_("not known")
FRAME_SYMBOLS = ("psi", "R", "SDD", "u_c", "tau")


@dataclass(frozen=True)
class ReportedParameter:
    """A parameter of the geometry: name, symbol, value and standard deviation, also in radians or as a slope."""

    name: str
    symbol: str
    value: str
    deviation: str
    beside: str = ""
    twin: str = ""


Row = tuple[str, str]
BUDGET_COLUMNS = (N_("kind"), N_("std. unc."), N_("mm / unit"), N_("rays, mm"), "%", N_("scale, %"), "%")
BUDGET_PARTS = {"sum": N_("added up"), "bound": N_("in the bounds alone"), "neither": N_("assumed, in no other number")}
BUDGET_NOTES = (
    N_("A: from the scan's own scatter. B: from other knowledge. Noise, scatter and misfit are line integrals."),
    N_("*: no standard deviation, but an allowance, mostly more than scans show; of the aspect, the limit."),
    N_("Rays: the sum is %(rms)s mm; the 95 %% bound is %(bound)s mm, by draws from all that counts."),
    N_("Scale: the 95 %% bound is %(scale)s %%, 1.96 times the sum, and the whole aspect."),
    N_("Another distance of the cells changes SDD and u_c alone. Another r_S changes h_S alone, unless R was held."),
    N_("This is no accreditation and no certificate. Millimetres are traceable as far as the phantom's ruler is."),
)
GROWN = N_("The phantom has grown by %(grown)s %%: lengths in the image are too small by that. Measure it again.")


def moment(time: datetime) -> str:
    """Format a time with its zone, for example 2026-11-22 18:44 EET (UTC+02:00)."""
    offset = time.strftime("%z")
    return f"{time:%Y-%m-%d %H:%M} {time.tzname()} (UTC{offset[:3]}:{offset[3:]})"


def theta_rows(geometry: FoundGeometry) -> list[ReportedParameter]:
    """Return theta with its standard deviations, and its twin."""
    theta, twin, deviation = geometry.theta, geometry.theta_twin, geometry.deviations.theta

    def length(name: str, text: str, symbol: str) -> ReportedParameter:
        value, twin_text = getattr(theta, name), "" if twin is None else f"{getattr(twin, name):.2f} mm"
        spread = _plus_minus(getattr(deviation, name), "mm")
        return ReportedParameter(text, symbol, f"{value:.3f} mm", spread, twin=twin_text)

    angle = theta.initial_angle_rad
    return [
        ReportedParameter(
            N_("first angle"),
            "alpha_0",
            f"{math.degrees(angle):.4f}°",
            _plus_minus_degrees(deviation.initial_angle_rad),
            f"{angle:.6f} rad",
            "" if twin is None else f"{math.degrees(twin.initial_angle_rad):.2f}°",
        ),
        length("detector_to_cor_mm", N_("COR to detector"), "r_D"),
        length("source_shift_mm", N_("source shift"), "h_S"),
        length("detector_shift_mm", N_("detector shift"), "h_D"),
        ReportedParameter(
            N_("detector tilt"),
            "alpha_D",
            f"{_slope_degrees(theta):.4f}°",
            _plus_minus_degrees(_of_slope(theta, deviation.detector_tilt)),
            f"tan {theta.detector_tilt:.6f}",
            "" if twin is None else f"{_slope_degrees(twin):.2f}°",
        ),
    ]


def theta_values(theta: Theta) -> list[str]:
    """Format the five parameters of a theta as in `theta_rows`."""
    return [
        f"{math.degrees(theta.initial_angle_rad):.4f}°",
        *(f"{length:.3f} mm" for length in (theta.detector_to_cor_mm, theta.source_shift_mm, theta.detector_shift_mm)),
        f"{_slope_degrees(theta):.4f}°",
    ]


def theta_change(before: Theta, after: Theta) -> list[str]:
    """Describe the parameters that differ between two thetas, for example "source shift +3 mm"."""
    changes = [
        ("COR to detector", after.detector_to_cor_mm - before.detector_to_cor_mm, " mm"),
        ("source shift", after.source_shift_mm - before.source_shift_mm, " mm"),
        ("detector shift", after.detector_shift_mm - before.detector_shift_mm, " mm"),
        ("detector tilt", _slope_degrees(after) - _slope_degrees(before), "°"),
    ]
    return [f"{name} {change:+.3g}{unit}" for name, change, unit in changes if change]


def frame_rows(geometry: FoundGeometry) -> list[ReportedParameter]:
    """Return the source frame with its standard deviations."""
    frame, deviation = geometry.source_frame, geometry.deviations.source_frame

    def angle(name: str, text: str, symbol: str) -> ReportedParameter:
        value, spread = getattr(frame, name), _plus_minus_degrees(getattr(deviation, name))
        return ReportedParameter(text, symbol, f"{math.degrees(value):.4f}°", spread, f"{value:.6f} rad")

    def length(name: str, text: str, symbol: str) -> ReportedParameter:
        spread = _plus_minus(getattr(deviation, name), "mm")
        return ReportedParameter(text, symbol, f"{getattr(frame, name):.3f} mm", spread)

    return [
        angle("psi_rad", N_("direction of the first view"), "psi"),
        length("source_distance_mm", N_("source to COR"), "R"),
        length("source_to_detector_mm", N_("source to detector"), "SDD"),
        length("cor_column_mm", N_("COR on the detector"), "u_c"),
        angle("tilt_rad", N_("detector tilt"), "tau"),
        ReportedParameter(
            N_("magnification"), "M", f"{frame.magnification:.5f}", _plus_minus(deviation.magnification, "")
        ),
    ]


def correlations(geometry: FoundGeometry) -> list[tuple[str, list[str]]]:
    """Return the lower triangle of the source frame's correlations by rows, without parameters that have no error."""
    if geometry.covariance is None:
        return []
    covariance = np.array(geometry.covariance)
    deviations = np.sqrt(np.diag(covariance))
    determined = [index for index in range(len(FRAME_SYMBOLS)) if deviations[index] > 0.0]
    return [
        (
            FRAME_SYMBOLS[row],
            [
                f"{covariance[row, column] / (deviations[row] * deviations[column]):+z.3f}"
                for column in determined[: place + 1]
            ],
        )
        for place, row in enumerate(determined)
    ]


def comparison_rows(change: Comparison | None) -> list[Row]:
    """Return the changes since the previously active calibration."""
    if change is None:
        return []
    rows = [(N_("rays moved (RMS)"), f"{change.ray_change_mm:.3f} mm")]
    if change.scale_change_percent is not None:
        spread = change.scale_change_uncertainty_percent
        rows.append(
            (N_("scale"), f"{change.scale_change_percent:+z.3f} %" + ("" if spread is None else f" ± {spread:.2g} %"))
        )
    return [
        *rows,
        (N_("COR on the detector"), f"{change.cor_column_change_mm:+z.3f} mm"),
        (N_("source distance"), f"{change.source_distance_change_mm:+z.3f} mm"),
        (N_("detector tilt"), f"{change.tilt_change_deg:+z.3f}°"),
        (N_("first angle"), f"{change.angle_change_deg:+z.3f}°"),
    ]


def hypothesis_rows(pose: PhantomPose) -> list[tuple[str, str, str]]:
    """Return each hypothesis with its residual and its log-likelihood deficit to the best hypothesis."""
    return [
        (
            f"{each.handedness}, {each.rotation}",
            f"{each.relative_residual:.3%}",
            NOT_KNOWN if each.log_likelihood_behind is None else f"{each.log_likelihood_behind:.1f}",
        )
        for each in pose.hypotheses
    ]


def witness_rows(witness: LogCheck) -> list[tuple[str, str, str]]:
    """Return u_c and tilt by the phantom and by the log, their difference, and the reported values."""
    rows = []
    for part in (N_("phantom"), N_("log"), N_("difference"), N_("reported")):
        value, spread = getattr(witness, part), getattr(witness, f"{part}_standard_deviation")
        column = f"{value.cor_column_mm:.3f} mm {_plus_minus(spread.cor_column_mm, 'mm')}"
        rows.append((part, column, f"{math.degrees(value.tilt_rad):.4f}° {_plus_minus_degrees(spread.tilt_rad)}"))
    return rows


def budget_rows(result: CalibrationResult) -> list[tuple[str, list[str]]]:
    """Return each source of uncertainty with the cells of its row, by where the sources count; titles have no cells."""
    rows: list[tuple[str, list[str]]] = []
    for counted, title in BUDGET_PARTS.items():
        rows.append((title, []))
        for line in (line for line in result.uncertainty_budget if line.counted_in == counted):
            of_rays = (line.standard_uncertainty, line.rays_mm_per_unit, line.rays_mm, line.rays_share_percent)
            size, *cells = map(_three_digits, (*of_rays, line.scale_percent, line.scale_share_percent))
            label = SOURCES[line.source].label if line.source in SOURCES else line.source
            kind = line.kind if line.states == "standard-deviation" else f"{line.kind} *"
            unit = line.unit if line.change is None else f"({line.change:+z.3g}) {line.unit}"
            rows.append((label, [kind, f"{size} {unit}".removesuffix(" 1").strip(), *cells]))
    return rows


def budget_notes(result: CalibrationResult, reader: Reader = ENGLISH) -> list[str]:
    """Return sentences on the budget: its kinds, the bounds, and what it is not."""
    error, scale = result.predicted_ray_error_mm, result.scale_uncertainty_percent
    values = {"rms": error.rms if error else None, "bound": error.upper_95 if error else None, "scale": scale}
    written = {name: reader.localised(_three_digits(value)) for name, value in values.items()}
    changed = [line for line in result.uncertainty_budget if line.change is not None]
    grown = [SOURCES[line.source].scale_by_unit * (line.change or 0.0) for line in changed]
    written["grown"] = reader.localised(f"{sum(grown):+z.3g}")
    return [reader.words(note) % written for note in (*BUDGET_NOTES, *([GROWN] if grown else []))]


def _three_digits(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}" if value >= 1e-4 or value == 0.0 else "< 0.0001"


def position(pose: PhantomPose) -> str:
    """Format the position of the phantom."""
    x_mm, y_mm = pose.phantom_position_mm
    return f"x {x_mm:z.2f} mm, y {y_mm:z.2f} mm"


def phantom_sides(drawing: PhantomDrawing, reader: Reader = ENGLISH) -> str:
    """Describe the phantom's measured sides with their dates, or its drawn extent if nobody measured it."""
    if drawing.measurements:
        return "; ".join(_measured(each, reader) for each in drawing.measurements)
    wood: Sequence[Shape] = [shape for shape in drawing.shapes if shape.density > 0.0] or drawing.shapes
    extents = np.array([shape.extent_mm for shape in wood])
    along_x, along_y = extents[:, 2:].max(axis=0) - extents[:, :2].min(axis=0)
    drawn = reader.words(N_("drawn %(size)s along x and y; no measurement is recorded"))
    return drawn % {"size": reader.localised(f"{along_x:g} x {along_y:g} mm")}


def size_tolerance(drawing: PhantomDrawing, reader: Reader = ENGLISH) -> str:
    """Format the relative standard uncertainty of the phantom's size."""
    what = reader.words(N_("standard uncertainty"))
    return f"± {reader.localised(f'{100 * drawing.size_tolerance:.2g} %')} ({what})"


def _measured(side: SizeMeasurement, reader: Reader) -> str:
    on = reader.words(N_("no date")) if side.measured_on is None else f"{side.measured_on:%Y-%m-%d}"
    return f"{side.dimension} {reader.localised(f'{side.measured_mm:g} ± {side.standard_uncertainty_mm:g} mm')} ({on})"


def lost(loss: ContrastLoss, reader: Reader = ENGLISH) -> str:
    """Format losses of contrast."""
    both = {"knot": loss.knot_10_mm_percent, "mtf": loss.mtf_percent}
    values = {name: f"{percent:.2g}" if percent >= 0.1 else "< 0.1" for name, percent in both.items()}
    return reader.localised(reader.words(N_("knots of 10 mm %(knot)s %%, MTF at 0.1 per mm %(mtf)s %%")) % values)


def _slope_degrees(theta: Theta) -> float:
    return math.degrees(math.atan(theta.detector_tilt))


def _of_slope(theta: Theta, deviation: float | None) -> float | None:
    """Convert the standard deviation of a slope to the deviation of the angle whose tangent is the slope."""
    return None if deviation is None else deviation / (1.0 + theta.detector_tilt**2)


def _plus_minus(deviation: float | None, unit: str) -> str:
    return N_("no error bar") if deviation is None else f"± {deviation:.2g} {unit}".rstrip()


def _plus_minus_degrees(deviation_rad: float | None) -> str:
    return "no error bar" if deviation_rad is None else f"± {math.degrees(deviation_rad):.2g}°"


def calibration_table(result: CalibrationResult) -> list[tuple[str, str]]:
    """Return labels and values, with standard deviations where these are known."""
    _, source, *others, _ = frame_rows(result)
    size = ("  from the phantom's size", f"± {result.scale_uncertainty_mm:.3g} mm (systematic)")
    rows = [*map(_as_row, theta_rows(result)), _as_row(source), size, *map(_as_row, others)]
    if (error := result.predicted_ray_error_mm) is not None:
        rows.append(("predicted ray error", f"{error.rms:.4f} mm RMS, 95 % below {error.upper_95:.4f} mm"))
        if error.contrast_loss is not None and error.contrast_loss.matters:
            rows.append(("  contrast lost (95 %)", lost(error.contrast_loss)))
    rows.append(("ray error from phantom size", f"± {result.scale_ray_error_mm:.3g} mm RMS (systematic)"))
    if result.scale_uncertainty_percent is not None:
        rows.append(("scale of the image", f"± {result.scale_uncertainty_percent:.2g} % (95 %)"))
    if result.status is not None:
        rows.append(("status", str(result.status)))
    rows.append(("seen / turning", f"{result.handedness} / {result.rotation}"))
    for second in result.hypotheses[1:2]:
        unexplained = f"{second.relative_residual:.2%} unexplained"
        rows.append(("  next best", f"{second.handedness} / {second.rotation}, {unexplained}"))
    return [
        *rows,
        ("phantom's position", "({:.2f}, {:.2f}) mm".format(*result.phantom_position_mm)),
        ("residual", f"{result.residual.relative:.3%} of the sinogram"),
        ("views, rows", "{}, {}:{}".format(result.views, *result.rows)),
        ("time", f"{result.timing_s.total:.2f} s"),
    ]


def _as_row(parameter: ReportedParameter) -> tuple[str, str]:
    return f"{parameter.name} {parameter.symbol}", f"{parameter.value} {parameter.deviation}"
