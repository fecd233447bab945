"""Readable answers: tables on standard output, remarks on standard error."""

import math

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sawmill_calibration.pictures.report_numbers import calibration_table
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.drifts import DriftResult
from sawmill_contracts.plans import PlanResult, RepeatabilityResult
from sawmill_contracts.reconstructions import MethodReport
from sawmill_vocabulary import ReconstructionMethod
from sawmill_worker.commands.terminal import say


def print_calibration(result: CalibrationResult) -> None:
    """Print the verdict, the numbers and the reasons."""
    colour = {"pass": "green", "watch": "yellow", "fail": "red"}[result.verdict]
    title = f"Calibration with {escape(result.phantom)}: [bold {colour}]{result.verdict}[/]"
    table = Table(title=title, show_header=False)
    for label, value in calibration_table(result):
        table.add_row(label, value)
    console = Console()
    console.print(table)
    for reason in result.reasons:
        console.print(f"- {reason}", highlight=False, markup=False)


def print_drift(result: DriftResult) -> None:
    """Print what changed or was determined, and the quantities that a scan without a phantom does not show."""
    of_given = result.reference == "given-geometry"
    word, colour = {
        True: ("within tolerance", "green"),
        False: ("out of tolerance", "red"),
        None: ("too uncertain to say", "yellow"),
    }[result.within_tolerance]
    table = Table(title="Centre of rotation from a given geometry" if of_given else f"Drift: [bold {colour}]{word}[/]")
    for column in ("", "measured", "given" if of_given else "calibrated", "change", "± sd", "in sd"):
        table.add_column(column, justify="right" if column else "left")
    units = {
        "COR on the detector, mm": ("cor_column_mm", 1.0),
        "tilt, °": ("tilt_rad", math.degrees(1.0)),
        "source to detector, mm (weakly seen)": ("source_to_detector_mm", 1.0),
    }
    for label, (name, unit) in units.items():
        three = (result.measured, result.calibrated, result.change)
        measured, calibrated, change = (unit * getattr(part, name) for part in three)
        spread, significance = (getattr(part, name) for part in (result.change_standard_deviation, result.significance))
        if spread is None or significance is None:
            table.add_row(label, "not seen", f"{calibrated:.3f}", "held", "", "")
            continue
        spread *= unit
        table.add_row(
            label, f"{measured:.3f}", f"{calibrated:.3f}", f"{change:+.3f}", f"{spread:.2g}", f"{significance:+.1f}"
        )
    if (zero := result.baseline) is not None:
        label = f"since {zero.checks} first logs: COR, mm"
        parts = (zero.change.cor_column_mm, zero.change_standard_deviation.cor_column_mm)
        table.add_row(label, "", "", f"{parts[0]:+.3f}", f"{parts[1]:.2g}", f"{zero.significance.cor_column_mm:+.1f}")
    if not of_given:
        moved = f"{result.ray_change_mm:.3f} ± {result.ray_change_uncertainty_mm:.2g} mm RMS"
        table.add_row("rays moved", "", "", moved, "", "")
    has_scale = result.scale_change_percent is not None and result.scale_change_uncertainty_percent is not None
    if has_scale and not of_given:
        scale = f"{result.scale_change_percent:+.3f} ± {result.scale_change_uncertainty_percent:.2g} %"
        table.add_row("scale changed", "", "", scale, "", "")
    console = Console()
    console.print(table)
    console.print(f"- {result.reason}", highlight=False, markup=False)
    for done in result.adjustments:
        console.print(f"- {done}", highlight=False, markup=False)
    for blind in result.not_seen:
        console.print(f"- not seen: {blind}", highlight=False, markup=False)


def print_repeatability(result: RepeatabilityResult) -> None:
    """Print one row per pair of calibrations: differences with standard deviations."""
    colour = "green" if result.verdict == "repeatable" else "red"
    table = Table(title=f"Repeatability: [bold {colour}]{result.verdict}[/]", box=box.SIMPLE, padding=0)
    table.add_column("pair", overflow="fold")
    for column in ("rays mm", "allowed mm", "scale %", "COR mm", "tilt °", ""):
        table.add_column(column, justify="right", no_wrap=True)
    for pair in result.pairs:
        table.add_row(
            escape(f"{pair.first} - {pair.second}"),
            f"{pair.ray_difference_mm:.3f}",
            f"{pair.allowed_mm:.3f}",
            f"{pair.scale_difference_percent:+.3f} ± {pair.scale_difference_deviation_percent:.2g}",
            f"{pair.cor_column_difference_mm:+.3f} ± {pair.cor_column_deviation_mm:.2g}",
            f"{pair.tilt_difference_deg:+.3f} ± {pair.tilt_deviation_deg:.2g}",
            "agree" if pair.within_error_bars else "differ",
        )
    console = Console()
    console.print(table)
    console.print(f"- {result.reason}", highlight=False, markup=False)


def report_method(done: MethodReport) -> None:
    """Report the choices of the method, and how well the slices explain the data."""
    if done.reason is not None:
        say(f"{done.name.value} was chosen: {done.reason}")
    # FBP fits no data: its misfit does not measure a fit, and a remark reports a misfit that shows a wrong geometry.
    if done.data_misfit is not None and done.name is not ReconstructionMethod.FBP:
        say(f"the slices miss the data by {done.data_misfit:.3g} times the noise")
    if done.metal is not None and done.metal.slices:
        slices = "1 slice" if done.metal.slices == 1 else f"{done.metal.slices} slices"
        say(
            f"metal in {slices}: {done.metal.share_of_samples:.1%} of their rays were {done.metal.treatment} "
            f"({done.metal.source})"
        )
    for remark in done.remarks:
        say(remark)


def print_plans(plans: list[PlanResult]) -> None:
    """Print one row per phantom and number of views."""
    table = Table(
        title=f"Standard deviations, noise {plans[0].noise:.3g} of the sinogram's RMS",
        caption="rays: RMS inside the log, and what 95 of 100 calibrations stay below; "
        "scale: of the image's millimetres, 95 %, from the phantom's size tolerance and the noise",
        box=box.SIMPLE,
        padding=(0, 1, 0, 0),
    )
    for column in ("phantom", "views", "R mm", "COR mm", "tilt °", "psi °", "rays mm", "95 % mm", "scale %"):
        table.add_column(column, justify="left" if column == "phantom" else "right")
    for each in plans:
        spread, predicted = each.standard_deviation.source_frame, each.predicted_ray_error_mm
        lengths = (spread.source_distance_mm, spread.cor_column_mm)
        angles = (math.degrees(value or 0.0) for value in (spread.tilt_rad, spread.psi_rad))
        numbers = (*lengths, *angles, predicted.rms, predicted.upper_95, (each.scale_uncertainty_percent or 0.0))
        table.add_row(escape(each.phantom), str(each.views), *(f"{value:.2g}" for value in numbers))
    Console().print(table)
