"""Readable answers: tables on standard output, remarks on standard error."""

import math
from collections.abc import Iterable, Iterator, Mapping

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from sawmill_calibration.pictures import report_numbers as numbers
from sawmill_calibration.scans.pack import ScanPack
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.drifts import DriftResult
from sawmill_contracts.fixed_pairs import FixedPairsResult
from sawmill_contracts.inspections import FilePart, FileVerdict, InspectedReading, InspectionResult
from sawmill_contracts.pair_logs import LogOnPairs
from sawmill_contracts.plans import PlanResult, RepeatabilityResult
from sawmill_contracts.reconstructions import MethodReport
from sawmill_formats.input.contents import PartKind
from sawmill_tomography.reconstruction.image_quality import ImageQuality
from sawmill_vocabulary import ReconstructionMethod, Verdict
from sawmill_worker.commands.terminal import say

COLOURS: Mapping[Verdict, str] = {"pass": "green", "watch": "yellow", "fail": "red"}


def print_calibration(result: CalibrationResult) -> None:
    """Print the verdict, the numbers and the reasons."""
    colour = COLOURS[result.verdict]
    title = f"Calibration with {escape(result.phantom)}: [bold {colour}]{result.verdict}[/]"
    table = Table(title=title, show_header=False)
    for label, value in numbers.calibration_table(result):
        table.add_row(label, value)
    _print_with_remarks(table, result.reasons)


def print_pairs(result: FixedPairsResult) -> None:
    """Print the verdict on a scanner of fixed pairs, each pair's geometry with standard deviations, and the reasons."""
    colour = COLOURS[result.verdict]
    table = Table(title=f"{len(result.pairs)} pairs with {escape(result.phantom)}: [bold {colour}]{result.verdict}[/]")
    table.add_column("")
    for number in range(1, len(result.pairs) + 1):
        table.add_column(f"pair {number}", justify="right")
    for label, (name, unit) in {
        "angle, °": ("psi_rad", math.degrees(1.0)),
        "source to centre, mm": ("source_distance_mm", 1.0),
        "source to detector, mm": ("source_to_detector_mm", 1.0),
        "centre on the detector, mm": ("cor_column_mm", 1.0),
        "tilt, °": ("tilt_rad", math.degrees(1.0)),
    }.items():
        cells = []
        for pair in result.pairs:
            value, deviation = (getattr(part, name) for part in (pair.source_frame, pair.standard_deviation))
            cells.append(f"{unit * value:.2f} ± {unit * deviation:.2g}")
        table.add_row(label, *cells)
    table.add_row("rays, 95 %, mm", *(f"{pair.upper_95_mm:.3f}" for pair in result.pairs))
    console = Console()
    console.print(table)
    rolls = ", ".join(f"{passage.roll_deg:.1f}°" for passage in result.passages)
    say_of_all = f"All rays: {result.predicted_rms_mm:.3f} mm, 95 % below {result.upper_95_mm:.3f} mm; sizes ± "
    console.print(f"{say_of_all}{result.scale_uncertainty_percent:.2g} %. Board rolled by {rolls}.")
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
    for label, (name, unit) in {
        "COR on the detector, mm": ("cor_column_mm", 1.0),
        "tilt, °": ("tilt_rad", math.degrees(1.0)),
        "source to detector, mm (weakly seen)": ("source_to_detector_mm", 1.0),
    }.items():
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
        if result.contrast_loss is not None:
            table.add_row("contrast lost", "", "", numbers.lost(result.contrast_loss), "", "")
    has_scale = result.scale_change_percent is not None and result.scale_change_uncertainty_percent is not None
    if has_scale and not of_given:
        scale = f"{result.scale_change_percent:+.3f} ± {result.scale_change_uncertainty_percent:.2g} %"
        table.add_row("scale changed", "", "", scale, "", "")
    not_seen = (f"not seen: {blind}" for blind in result.not_seen)
    _print_with_remarks(table, [result.reason, *result.adjustments, *not_seen])


def print_budget(result: CalibrationResult) -> None:
    """Print the uncertainty budget, and what it is not."""
    columns = (Column(name, justify="right", no_wrap=True) for name in numbers.BUDGET_COLUMNS)
    table = Table("source", *columns, title="Uncertainty budget", box=box.SIMPLE, padding=0)
    for label, cells in numbers.budget_rows(result):
        table.add_row(escape(label) if cells else f"[bold]{label}[/]", *cells)
    Console().print(table, *(f"- {note}" for note in numbers.budget_notes(result)), sep="\n", highlight=False)


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
    _print_with_remarks(table, [result.reason])


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


# Largest number of parts, and of other files, that are shown: about a page. `--json` prints all.
MOST_ROWS, MOST_FILES = 60, 3
WORDS = {
    FileVerdict.READY: ("can be read", "green"),
    FileVerdict.INCOMPLETE: ("more must be given", "yellow"),
    FileVerdict.REFUSED: ("refused", "red"),
}


def print_inspection(result: InspectionResult) -> None:
    """Print the parts of a file, the data that would be read, and the data that is missing."""
    word, colour = WORDS[result.verdict]
    what = f"{escape(result.file)}: {result.format or 'not readable'}, {_size(result.size_bytes)}"
    console = Console()
    console.print(f"{what}: [bold {colour}]{word}[/]", highlight=False, soft_wrap=True)
    if result.parts:
        table = Table(box=box.SIMPLE, padding=(0, 1, 0, 0))
        for column in ("in the file", "what"):
            table.add_column(column, overflow="fold")
        table.add_column("stored", justify="right", no_wrap=True)
        table.add_column("filters")
        names: set[str] = set()
        for part in result.parts[:MOST_ROWS]:
            stored = "" if part.stored_bytes is None else _size(part.stored_bytes)
            table.add_row(*map(escape, (_indented(part.name, names), _what(part), stored, part.compression or "")))
            names.add(part.name)
        console.print(table)
    if result.reading is not None:
        console.print(_reading_table(result.reading))
    for sentence in _sentences(result):
        console.print(f"- {sentence}", highlight=False, markup=False)


def print_image_quality(quality: ImageQuality) -> None:
    """Print the disc, the frequency at which the MTF is 10 %, and the contrast that patches of doubled sides show."""
    lines = [f"disc: radius {quality.radius_mm:.4g} mm, pixels of {quality.pixel_mm:.4g} mm"]
    lines += [f"MTF at 10 %: {quality.mtf_10_per_mm:.4g} per mm"]
    for number, (side, contrast) in enumerate(zip(quality.patch_mm, quality.contrast_percent, strict=True), 1):
        lines += [f"contrast discrimination, patches of {side:.3g} mm: {contrast:.3g} %"] * (number.bit_count() == 1)
    Console().print("\n".join(lines), highlight=False, markup=False)


def print_marks(log: LogOnPairs) -> None:
    """Print the places of a log's marks, and how far the pairs agree."""
    table = Table("x, mm", "y, mm", "along the feed, mm", "pairs", "residual, mm", title=f"{len(log.marks)} marks")
    for mark in log.marks:
        numbers = (f"{at:.2f} ± {off:.2f}" for at, off in zip(mark.place_mm, mark.deviations_mm, strict=True))
        pairs = ", ".join(map(str, mark.pairs)) + " or elsewhere" * mark.is_ambiguous
        table.add_row(*numbers, pairs, f"{mark.residual_mm:.2f}" if len(mark.pairs) > 2 else "-")
    shifts = [f"{at:+.2f} ± {off:.2f}" for at, off in zip(log.agreement.moved_mm, log.agreement.within_mm, strict=True)]
    suspect = log.agreement.suspect
    sentence = {
        "agree": "The pairs agree",
        "disagree": "The pairs do not agree: one has moved" + (f", probably pair {suspect}" if suspect else ""),
        "unknown": "This log does not show whether the pairs agree",
    }[log.agreement.state]
    console = Console()
    console.print(table)
    console.print(f"{sentence}; mm, of each pair if it alone has moved: {', '.join(shifts) or 'not known'}.")
    if log.unplaced:
        console.print(f"{log.unplaced} more marks are in no place: too few pairs show them, or they do not meet.")


def print_pack(packed: ScanPack) -> None:
    """Print what a packed scan keeps, what it leaves out, and what nobody knows."""
    lines = [f"kept: {name}: {value}" for name, value in packed.kept.items()]
    left_out = [f"left out: {place}: {text}" for place, text in packed.left_out.items()]
    lines += left_out[:MOST_ROWS] + [f"left out: {len(left_out) - MOST_ROWS} more (--json)"] * (
        len(left_out) > MOST_ROWS
    )
    lines += [f"not known: {name} ({flag})" for name, flag in packed.unknown.items()]
    Console().print("\n".join(lines), highlight=False, markup=False, soft_wrap=True)


def _sentences(result: InspectionResult) -> Iterator[str]:
    left_out = result.parts_left_out + max(0, len(result.parts) - MOST_ROWS)
    if left_out:
        yield f"{left_out} more parts are not shown; --json lists {len(result.parts)}"
    if result.listing_ended is not None and (result.refusal is None or result.refusal.detail != result.listing_ended):
        yield f"the list ends there: {result.listing_ended}"
    if result.reading is not None:
        yield from result.reading.remarks
    for part in result.missing:
        yield f"{'missing' if part.needed else 'not in the file'}: {part.name} ({part.flag}): {part.why}"
    if result.refusal is not None:
        yield f"{result.refusal.code}: {result.refusal.detail}"


def _indented(name: str, before: set[str]) -> str:
    """Indent a name below its group or struct, if the group or struct is shown."""
    group, slash, last = name.rpartition("/")
    return f"{'  ' * group.count('/')}  {slash if group.startswith('/') else ''}{last}" if group in before else name


def _what(part: FilePart) -> str:
    number = part.kind if part.count == 1 else f"{part.count} {part.kind}s, each"
    shape = "" if part.shape is None else " x ".join(map(str, part.shape)) or "one value"
    link = part.kind == PartKind.LINK
    leads_to = "" if part.leads_to is None else f"-> {part.leads_to}" if link else f"({part.leads_to})"
    kind = number if part.count > 1 or not (shape or link) else ""
    return " ".join(filter(None, (kind, shape, part.type, "" if part.unit is None else f"in {part.unit}", leads_to)))


def _reading_table(reading: InspectedReading) -> Table:
    table = Table(
        title="What would be read", title_justify="left", show_header=False, box=box.SIMPLE, padding=(0, 1, 0, 0)
    )
    shape, angles = reading.shape, reading.angles
    turn = "" if angles is None else f"{angles.first_deg:.7g} to {angles.last_deg:.7g} degrees"
    origin = "" if angles is None else f", from the file in {angles.file_unit}" if angles.from_file else ", as given"
    cells = ", ".join(str(module.first_cell) for module in reading.detector_modules)
    more = f" and {len(reading.other_files) - MOST_FILES} more" if len(reading.other_files) > MOST_FILES else ""
    for label, value in {
        "numbers": "not known" if reading.data is None else f"{reading.data.value}, as given",
        "projections": f"{shape.views} views x {shape.rows} rows x {shape.detector} cells",
        "flat fields": "none" if reading.flats is None else str(reading.flats),
        "dark fields": "none" if reading.darks is None else str(reading.darks),
        "angles": "none" if angles is None else turn + origin,
        "detector pitch": "none" if reading.detector_pitch_mm is None else f"{reading.detector_pitch_mm:.9g} mm",
        "modules": f"{len(reading.detector_modules) + 1}, which meet at cell {cells}" if cells else None,
        "arc": f"of radius {radius_mm:.9g} mm" if (radius_mm := reading.detector_arc_radius_mm) else None,
        "row pitch": "none" if reading.row_pitch_mm is None else f"{reading.row_pitch_mm:.9g} mm",
        "other files": f"{', '.join(reading.other_files[:MOST_FILES])}{more}" if reading.other_files else None,
    }.items():
        if value is not None:
            table.add_row(label, escape(value))
    return table


def _print_with_remarks(table: Table, remarks: Iterable[str]) -> None:
    console = Console()
    console.print(table)
    for remark in remarks:
        console.print(f"- {remark}", highlight=False, markup=False)


def _size(number: int) -> str:
    """Format a number of bytes for people."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if number >= factor:
            return f"{number / factor:.3g} {unit}"
    return f"{number} B"
