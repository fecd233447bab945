"""The commands that need no server: calibrate, drift, reconstruct, simulate, export, phantom, worker.

Here stand their flags, what is wrong use of them, and what they print. What they do stands in
`sawmill_worker.commands` and is imported by the command that does it: no command waits for another's libraries.
"""
# ruff: noqa: PLC0415, FBT002 - imports inside the commands, for that reason; flags are booleans with a default

import math
import os
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal
from uuid import uuid4

import typer
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sawmill_worker.commands import options as given
from sawmill_worker.commands.options import (
    CalibrationSaid,
    PhantomSaid,
    PicturesSaid,
    ScanSaid,
    ThetaSaid,
    wrong_use_told,
)
from sawmill_worker.commands.terminal import answering, print_json, say, showing_progress
from sawmill_worker.contracts.calibrations import CalibrationFile, CalibrationOptions, CalibrationResult, PaperOptions
from sawmill_worker.contracts.drifts import DriftOptions, DriftResult
from sawmill_worker.contracts.geometry import ScannerConstants
from sawmill_worker.contracts.plans import PlanOptions, PlanResult
from sawmill_worker.contracts.preparing import PrepareOptions
from sawmill_worker.contracts.reconstructions import MethodReport, ReconstructionOptions
from sawmill_worker.pictures.calibration_table import calibration_table
from sawmill_worker.readers.angles import AngleSteps
from sawmill_worker.vocabulary import (
    Adjustment,
    AirCorrection,
    AlphaRule,
    CalibrationMethod,
    DataKind,
    FaultyCells,
    FilterName,
    Handedness,
    ReconstructionMethod,
    RingRemoval,
    Rotation,
    RowAlignment,
)

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_show_locals=False)
phantom_app = typer.Typer(no_args_is_help=True)
app.add_typer(phantom_app, name="phantom", help="Choose a phantom, and draw it.")


def _print_version(asked: bool) -> None:  # noqa: FBT001 - Typer's callback
    if asked:
        typer.echo(version("sawmill-calibration"))
        raise typer.Exit


@app.callback()
def sawmill(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Geometry calibration and reconstruction for sawmill X-ray log scanners."""


@app.command()
def calibrate(
    scan: given.ScanFile,
    data: given.Data,
    source_to_cor_mm: given.SourceToCor,
    phantom: given.PhantomText,
    dataset: given.Dataset = None,
    angles_deg: given.AnglesDeg = None,
    angles_file: given.AnglesFile = None,
    views: given.Views = None,
    rows: given.RowsText = None,
    detector_pitch_mm: given.DetectorPitch = None,
    row_pitch_mm: given.RowPitch = None,
    air: given.AirFlag = AirCorrection.AUTO,
    faulty_cells: given.FaultyCellsFlag = FaultyCells.AUTO,
    rings: given.RingsFlag = RingRemoval.OFF,
    align_rows: given.AlignRows = RowAlignment.OFF,
    phantom_width_mm: given.PhantomWidth = None,
    handedness: Annotated[
        Handedness | None, typer.Option(help="From which end the phantom was seen; without it both are tried.")
    ] = None,
    rotation: Annotated[
        Rotation | None, typer.Option(help="Which way the angles count; without it both are tried.")
    ] = None,
    method: Annotated[
        CalibrationMethod, typer.Option(help="The product's own, or the published search.")
    ] = CalibrationMethod.DEFAULT,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Of the search.")] = 7,
    rays_per_cell: Annotated[
        int | None, typer.Option(min=1, max=64, help="Rays a cell in the model; the whole cell by default.")
    ] = None,
    without: Annotated[
        list[Adjustment] | None,
        typer.Option(help="What is not to be done by itself about a scan with faults; may be repeated."),
    ] = None,
    paper_objective: Annotated[
        Literal["image", "projection"] | None, typer.Option(help="Correlate images, or compare sinograms.")
    ] = None,
    paper_weighting: Annotated[Literal["none", "exact"] | None, typer.Option(help="FBP weights.")] = None,
    paper_correlation: Annotated[Literal["unnormalised", "normalised"] | None, typer.Option()] = None,
    paper_stop: Annotated[
        Literal["published", "tight"] | None, typer.Option(help="SciPy's stop, or one that waits for convergence.")
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(metavar="OUT.png", dir_okay=False, callback=given.writable, help="Write a report picture."),
    ] = None,
    as_json: given.JsonFlag = False,
) -> None:
    """Find the geometry from a scan of a phantom."""
    paper = {
        "objective": paper_objective,
        "weighting": paper_weighting,
        "correlation": paper_correlation,
        "stop": paper_stop,
    }
    chosen = {name: value for name, value in paper.items() if value is not None}
    if chosen and method is not CalibrationMethod.PAPER:
        raise typer.BadParameter(f"--paper-{next(iter(chosen))} comes with --method paper.")
    with wrong_use_told():
        options = CalibrationOptions(
            rows=rows,
            views=views,
            handedness=handedness,
            rotation=rotation,
            method=method,
            seed=seed,
            rays_per_cell=rays_per_cell,
            without=without or [],
            paper=PaperOptions.model_validate(chosen),
        )
    said = ScanSaid(
        path=scan,
        data=data,
        dataset=dataset,
        angles=given.given_angles(angles_deg, angles_file),
        views=views,
        rows=options.rows,
        detector_pitch_mm=detector_pitch_mm,
        row_pitch_mm=row_pitch_mm,
        prepare=PrepareOptions(air=air, faulty_cells=faulty_cells, rings=rings, align_rows=align_rows),
    )
    wood = PhantomSaid(phantom, phantom_width_mm)
    with answering(as_json=as_json), showing_progress("calibrate") as progress:
        from sawmill_worker.commands.calibrate import calibrate_scan

        result = calibrate_scan(said, wood, options, source_to_cor_mm=source_to_cor_mm, picture=report, report=progress)
    if as_json:
        print_json(CalibrationFile(id=str(uuid4()), **dict(result)).model_dump(mode="json"))
    else:
        _print_calibration(result)


def _print_calibration(result: CalibrationResult) -> None:
    colour = {"pass": "green", "watch": "yellow", "fail": "red"}[result.verdict]
    title = f"Calibration with {escape(result.phantom)}: [bold {colour}]{result.verdict}[/]"
    table = Table(title=title, show_header=False)
    for label, value in calibration_table(result.model_dump(mode="json")):
        table.add_row(label, value)
    console = Console()
    console.print(table)
    for reason in result.reasons:
        console.print(f"- {reason}", highlight=False, markup=False)


@app.command()
def drift(
    scan: given.ScanFile,
    data: given.Data,
    calibration: Annotated[
        Path,
        typer.Option(metavar="RESULT.json", exists=True, dir_okay=False, help=given.CALIBRATION_HELP),
    ],
    source_to_cor_mm: Annotated[
        float | None, typer.Option(callback=given.length, help="r_S; the calibration carries it.")
    ] = None,
    dataset: given.Dataset = None,
    angles_deg: given.AnglesDeg = None,
    angles_file: given.AnglesFile = None,
    views: given.Views = None,
    rows: given.RowsText = None,
    detector_pitch_mm: given.DetectorPitch = None,
    row_pitch_mm: given.RowPitch = None,
    air: given.AirFlag = AirCorrection.AUTO,
    faulty_cells: given.FaultyCellsFlag = FaultyCells.AUTO,
    rings: given.RingsFlag = RingRemoval.OFF,
    align_rows: given.AlignRows = RowAlignment.OFF,
    tolerance_mm: Annotated[
        float, typer.Option(callback=given.length, help="RMS ray distance up to which nothing moved.")
    ] = 0.5,
    as_json: given.JsonFlag = False,
) -> None:
    """Say what moved since a calibration, from any dense full-turn scan, without a phantom."""
    with wrong_use_told():
        options = DriftOptions(rows=rows)
    said = ScanSaid(
        path=scan,
        data=data,
        dataset=dataset,
        angles=given.given_angles(angles_deg, angles_file),
        views=views,
        rows=options.rows,
        detector_pitch_mm=detector_pitch_mm,
        row_pitch_mm=row_pitch_mm,
        prepare=PrepareOptions(air=air, faulty_cells=faulty_cells, rings=rings, align_rows=align_rows),
    )
    known = CalibrationSaid(calibration, source_to_cor_mm)
    with answering(as_json=as_json), showing_progress("drift") as progress:
        from sawmill_worker.commands.drift import look_for_drift

        result = look_for_drift(said, known, tolerance_mm=tolerance_mm, report=progress)
    if as_json:
        print_json({"state": "succeeded", **result.model_dump(mode="json")})
    else:
        _print_drift(result)


def _print_drift(result: DriftResult) -> None:
    word, colour = {
        True: ("within tolerance", "green"),
        False: ("out of tolerance", "red"),
        None: ("too uncertain to say", "yellow"),
    }[result.within_tolerance]
    table = Table(title=f"Drift: [bold {colour}]{word}[/]")
    for column in ("", "measured", "calibrated", "change", "± sd", "sd's"):
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
    moved = f"{result.ray_change_mm:.3f} ± {result.ray_change_uncertainty_mm:.2g} mm RMS"
    table.add_row("rays moved", "", "", moved, "", "")
    console = Console()
    console.print(table)
    console.print(f"- {result.reason}", highlight=False, markup=False)
    for done in result.adjustments:
        console.print(f"- {done}", highlight=False, markup=False)
    for blind in result.not_seen:
        console.print(f"- not seen: {blind}", highlight=False, markup=False)


@app.command()
def reconstruct(
    scan: given.ScanFile,
    data: given.Data,
    output: given.Result,
    source_to_cor_mm: Annotated[
        float | None, typer.Option(callback=given.length, help="r_S, with --theta; a calibration carries it.")
    ] = None,
    dataset: given.Dataset = None,
    angles_deg: given.AnglesDeg = None,
    angles_file: given.AnglesFile = None,
    views: given.Views = None,
    rows: given.SteppedRowsText = None,
    detector_pitch_mm: given.DetectorPitch = None,
    row_pitch_mm: given.RowPitch = None,
    air: given.AirFlag = AirCorrection.AUTO,
    faulty_cells: given.FaultyCellsFlag = FaultyCells.AUTO,
    rings: given.RingsFlag = RingRemoval.OFF,
    align_rows: given.AlignRows = RowAlignment.OFF,
    theta: Annotated[str | None, typer.Option(metavar=given.THETA_FORM, help=given.THETA_HELP)] = None,
    rotation: Annotated[Rotation | None, typer.Option(help="With --theta: which way the angles count.")] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(metavar="RESULT.json", exists=True, dir_okay=False, help=given.CALIBRATION_HELP),
    ] = None,
    method: Annotated[ReconstructionMethod, typer.Option(help="How.")] = ReconstructionMethod.FBP,
    filter_name: Annotated[FilterName, typer.Option("--filter", help="Window on the ramp.")] = FilterName.HANN,
    frequency_scaling: Annotated[float, typer.Option(help="Cut-off as a fraction of the Nyquist frequency.")] = 1.0,
    weighting: Annotated[Literal["exact", "none"], typer.Option(help="none is the published pipeline's.")] = "exact",
    size: given.ImageSize = 256,
    field_mm: given.FieldSide = 400.0,
    field_centre_mm: given.FieldCentre = "0,0",
    alpha: Annotated[float | None, typer.Option(help="Of tikhonov, in mm²; chosen by --alpha-rule without it.")] = None,
    alpha_rule: Annotated[AlphaRule, typer.Option(help="How tikhonov chooses alpha.")] = AlphaRule.DISCREPANCY,
    sigma: Annotated[
        float | None, typer.Option(help="Of cauchy_map: noise of a line integral; found without it.")
    ] = None,
    beta: Annotated[
        float | None, typer.Option(help="Of cauchy_map: scale of neighbouring pixels' differences; found without it.")
    ] = None,
    preset: Annotated[
        Literal["paper"] | None, typer.Option(help="Of cauchy_map: the published sigma and beta.")
    ] = None,
    weight: Annotated[float | None, typer.Option(help="Of total_variation; found without it.")] = None,
    non_negative: Annotated[
        bool, typer.Option(help="Of cauchy_map and total_variation: no attenuation below zero.")
    ] = True,
    uncertainty: Annotated[
        bool, typer.Option("--uncertainty", help="Of cauchy_map: each pixel's standard deviation as well.")
    ] = False,
    png: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.png", dir_okay=False, callback=given.writable, help="Write a picture of the middle slice."
        ),
    ] = None,
    mosaic: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.png", dir_okay=False, callback=given.writable, help="Write a picture of slices along the log."
        ),
    ] = None,
    side: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.png", dir_okay=False, callback=given.writable, help="Write what is densest, from the side."
        ),
    ] = None,
    alpha_curve: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.png", dir_okay=False, callback=given.writable, help="Write how tikhonov's alpha was chosen."
        ),
    ] = None,
    as_json: given.JsonFlag = False,
) -> None:
    """Reconstruct each row of a scan."""
    geometry = _geometry_said(theta, rotation, calibration, source_to_cor_mm)
    if alpha_curve is not None and method is not ReconstructionMethod.TIKHONOV:
        raise typer.BadParameter("--alpha-curve is a picture of --method tikhonov.")
    with wrong_use_told():
        options = ReconstructionOptions(
            rows=rows,
            views=views,
            method=method,
            filter=filter_name,
            frequency_scaling=frequency_scaling,
            weighting=weighting,
            size=size,
            field_mm=field_mm,
            field_centre_mm=given.parse_position(field_centre_mm, "--field-centre-mm"),
            alpha=alpha,
            alpha_rule=alpha_rule,
            sigma=sigma,
            beta=beta,
            preset=preset,
            weight=weight,
            non_negative=non_negative,
            uncertainty=uncertainty,
        )
    said = ScanSaid(
        path=scan,
        data=data,
        dataset=dataset,
        angles=given.given_angles(angles_deg, angles_file),
        views=views,
        rows=options.rows,
        detector_pitch_mm=detector_pitch_mm,
        row_pitch_mm=row_pitch_mm,
        prepare=PrepareOptions(air=air, faulty_cells=faulty_cells, rings=rings, align_rows=align_rows),
    )
    with answering(as_json=as_json), showing_progress("reconstruct") as progress:
        from sawmill_worker.commands.reconstruct import reconstruct_scan

        result = reconstruct_scan(
            said,
            geometry,
            options,
            output=output,
            pictures=PicturesSaid(png, mosaic, side, alpha_curve),
            report=progress,
        )
    if as_json:
        print_json({"state": "succeeded", "output": str(output), **result.model_dump(mode="json")})
    slices, width, _ = result.shape
    say(f"{slices} slice(s) of {width} x {width} pixels in {result.time_s:.2f} s: {output}")
    if result.method is not None:
        _say_method(result.method)


def _say_method(done: MethodReport) -> None:
    if done.reason is not None:
        say(f"{done.name.value} was chosen: {done.reason}")
    # FBP fits no data: its misfit is no measure of the fit, and a remark says where it shows a wrong geometry.
    if done.data_misfit is not None and done.name is not ReconstructionMethod.FBP:
        say(f"the slices miss the data by {done.data_misfit:.3g} times the noise")
    for remark in done.remarks:
        say(remark)


def _geometry_said(
    theta: str | None, rotation: Rotation | None, calibration: Path | None, source_to_cor_mm: float | None
) -> ThetaSaid | CalibrationSaid:
    if theta is not None and calibration is None:
        five = given.parse_theta(theta)
        if source_to_cor_mm is None:
            raise typer.BadParameter("--theta needs --source-to-cor-mm.")
        return ThetaSaid(five, rotation or Rotation.AS_GIVEN, source_to_cor_mm)
    if theta is not None or calibration is None:
        raise typer.BadParameter("give the geometry as --theta or as --calibration, one of them.")
    if rotation is not None:
        raise typer.BadParameter("--rotation comes with --theta; a calibration carries its own.")
    return CalibrationSaid(calibration, source_to_cor_mm)


class Body(StrEnum):
    """What can be simulated beside a phantom."""

    LOG = "log"
    LOG_WITH_PHANTOM = "log-with-phantom"


@app.command()
def simulate(
    body: Annotated[
        str,
        typer.Argument(
            metavar="BODY",
            help="A phantom (as --phantom), log, or log-with-phantom, whose first rows show a phantom.",
        ),
    ],
    theta: Annotated[str, typer.Option(metavar=given.THETA_FORM, help=given.THETA_HELP)],
    output: given.Result,
    data: given.Data = DataKind.COUNTS,
    source_to_cor_mm: given.SourceToCor = 859.46,
    detector_pitch_mm: Annotated[
        float, typer.Option(callback=given.length, help="Distance between detector cells.")
    ] = 1.502864583,
    detector_pixels: Annotated[int, typer.Option(min=8, max=65_536, help="Cells of the detector.")] = 768,
    row_pitch_mm: given.RowPitch = 2.0,
    angles_deg: Annotated[
        str | None, typer.Option(metavar="START:STEP", help="A full turn from half a step by default.")
    ] = None,
    angles_file: given.AnglesFile = None,
    views: Annotated[int, typer.Option(min=3, help="Number of views.")] = 360,
    rows: Annotated[int, typer.Option(min=1, help="Rows of the stack.")] = 1,
    phantom: given.PhantomText = "l-shape",
    phantom_width_mm: given.PhantomWidth = None,
    phantom_rows: Annotated[int, typer.Option(min=1, help="Rows of log-with-phantom that show the phantom.")] = 4,
    position_mm: Annotated[str, typer.Option(metavar="X,Y", help="Where the phantom stands.")] = "0,0",
    handedness: Annotated[Handedness, typer.Option(help="From which end it is seen.")] = Handedness.AS_DRAWN,
    rotation: Annotated[Rotation, typer.Option(help="Which way the angles count.")] = Rotation.AS_GIVEN,
    noise: Annotated[
        float, typer.Option(min=0.0, help="Of line integrals: standard deviation against their RMS.")
    ] = 0.0,
    background: Annotated[float, typer.Option(help="Of line integrals: added everywhere.")] = 0.0,
    photons: Annotated[float, typer.Option(min=1.0, help="Of counts: in air, a cell and view.")] = 30_000.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the log and of all noise.")] = 1,
) -> None:
    """Simulate a scan of a phantom or a synthetic log, analytically, seeded."""
    angles = given.given_angles(angles_deg, angles_file) or AngleSteps(180.0 / views, 360.0 / views)
    five, position = given.parse_theta(theta), given.parse_position(position_mm)
    if body == Body.LOG_WITH_PHANTOM and phantom_rows >= rows:
        raise typer.BadParameter(f"--phantom-rows {phantom_rows} leaves no row for the log: give more --rows.")
    shown = PhantomSaid(phantom if body in set(Body) else body, phantom_width_mm)
    scanner = ScannerConstants(
        source_to_cor_mm=source_to_cor_mm,
        num_detector_pixels=detector_pixels,
        detector_pitch_mm=detector_pitch_mm,
        row_pitch_mm=row_pitch_mm,
    )
    with answering():
        from sawmill_worker.commands.simulate import log_slices, phantom_slices, simulate_scan

        wood = 0 if body == Body.LOG else phantom_rows if body == Body.LOG_WITH_PHANTOM else rows
        as_wood = data is DataKind.COUNTS or body == Body.LOG_WITH_PHANTOM
        slices = phantom_slices(shown, wood, handedness=handedness, position_mm=position, as_wood=as_wood)
        slices += log_slices(rows, row_pitch_mm=row_pitch_mm or 0.0, seed=seed)[wood:]
        simulate_scan(
            output,
            slices,
            data=data,
            scanner=scanner,
            theta=five,
            rotation=rotation,
            angles=angles,
            views=views,
            noise=noise,
            background=background,
            photons=photons,
            seed=seed,
        )
    say(f"{views} views, {rows} row(s), {detector_pixels} cells: {output}")


@app.command()
def export(
    calibration: Annotated[
        Path,
        typer.Option(metavar="RESULT.json", exists=True, dir_okay=False, help=given.CALIBRATION_HELP),
    ],
    to: Annotated[
        given.ExportTarget,
        typer.Option(
            help="astra: rows srcX srcY dX dY uX uY of fanflat_vec, mm; odl, cil: JSON of every argument; rtk: XML.",
        ),
    ],
    output: given.Result,
    views: Annotated[int, typer.Option(min=1, help="Number of views.")],
    angles_deg: given.AnglesDeg = None,
    angles_file: given.AnglesFile = None,
) -> None:
    """Write a calibrated geometry for another toolkit."""
    angles = given.given_angles(angles_deg, angles_file)
    if angles is None:
        raise typer.BadParameter("the views' angles are missing: give --angles-deg START:STEP or --angles-file.")
    with answering():
        from sawmill_worker.commands.export import export_geometry

        export_geometry(to, calibration, output, angles, views)
    say(f"{views} views: {output}")


@phantom_app.command()
def plan(
    phantoms: Annotated[
        list[str], typer.Argument(metavar="PHANTOM...", help="What to compare: names or files, as --phantom.")
    ],
    theta: Annotated[str, typer.Option(metavar=given.THETA_FORM, help=f"Nominal: {given.THETA_HELP}")],
    views: Annotated[
        list[int] | None, typer.Option(min=3, help="Views over a full turn; may be repeated. 20 and 360 by default.")
    ] = None,
    noise: Annotated[float, typer.Option(help="Standard deviation against the RMS of the sinogram.")] = 0.02,
    source_to_cor_mm: given.SourceToCor = 859.46,
    detector_pitch_mm: Annotated[
        float, typer.Option(callback=given.length, help="Distance between detector cells.")
    ] = 1.502864583,
    detector_pixels: Annotated[int, typer.Option(min=8, max=65_536, help="Cells of the detector.")] = 768,
    log_radius_mm: Annotated[float, typer.Option(callback=given.length, help="Of the largest log.")] = 150.0,
    phantom_width_mm: given.PhantomWidth = None,
    as_json: given.JsonFlag = False,
) -> None:
    """Say how well phantoms will calibrate a scanner, before they are made."""
    five = given.parse_theta(theta)
    said = [PhantomSaid(text, phantom_width_mm) for text in phantoms]
    with wrong_use_told():
        options = [PlanOptions(views=count, noise=noise) for count in views or (20, 360)]
    scanner = ScannerConstants(
        source_to_cor_mm=source_to_cor_mm, num_detector_pixels=detector_pixels, detector_pitch_mm=detector_pitch_mm
    )
    with answering(as_json=as_json):
        from sawmill_worker.commands.phantom import plan_phantoms

        plans = plan_phantoms(said, options, scanner=scanner, theta=five, log_radius_mm=log_radius_mm)
    if as_json:
        print_json({"state": "succeeded", "plans": [each.model_dump(mode="json") for each in plans]})
    else:
        Console().print(_plan_table(plans))
    for each in plans:
        if each.views_cut_off:
            say(f"{each.phantom}: {each.views_cut_off} of {each.views} views reach an end of the detector")


def _plan_table(plans: list[PlanResult]) -> Table:
    table = Table(
        title=f"Standard deviations, noise {plans[0].noise:.3g} of the sinogram's RMS",
        caption="rays: RMS inside the log, and what 95 of 100 calibrations stay below; "
        "size: RMS from the phantom's size tolerance, beside it",
        box=box.SIMPLE,
        padding=(0, 1, 0, 0),
    )
    for column in ("phantom", "views", "R mm", "COR mm", "tilt °", "psi °", "rays mm", "95 % mm", "size mm"):
        table.add_column(column, justify="left" if column == "phantom" else "right")
    for each in plans:
        spread, predicted = each.standard_deviation.source_frame, each.predicted_ray_error_mm
        lengths = (spread.source_distance_mm, spread.cor_column_mm)
        angles = (math.degrees(value or 0.0) for value in (spread.tilt_rad, spread.psi_rad))
        numbers = (*lengths, *angles, predicted.rms, predicted.upper_95, each.scale_ray_error_mm)
        table.add_row(escape(each.phantom), str(each.views), *(f"{value:.2g}" for value in numbers))
    return table


@phantom_app.command()
def draw(
    phantom: Annotated[str, typer.Argument(metavar="PHANTOM", help="A name or a file, as --phantom.")],
    output: given.Result,
    phantom_width_mm: given.PhantomWidth = None,
) -> None:
    """Draw a phantom as SVG in mm, to print at full size."""
    said = PhantomSaid(phantom, phantom_width_mm)
    with answering():
        from sawmill_worker.commands.phantom import draw_phantom

        draw_phantom(said, output)
    say(f"{phantom}, to be printed at 100 %: {output}")


@app.command()
def worker(
    data: Annotated[
        Path | None, typer.Option("--data", help="Data folder; SAWMILL_DATA_FOLDER or the default otherwise.")
    ] = None,
) -> None:
    """Run one embedded worker beside a service that uses the same data folder."""
    from sawmill_worker.execution.poller import main
    from sawmill_worker.execution.variables import UnknownVariableError, check_variables

    try:
        check_variables()
    except UnknownVariableError as error:
        raise typer.BadParameter(str(error)) from error
    if data is not None:
        os.environ["SAWMILL_DATA_FOLDER"] = str(data)
    main([])


@app.command(name="compile")
def compile_() -> None:
    """Compile the numerical kernels now: once on a machine, else the first job waits for it."""
    with answering(), showing_progress("compiling kernels, once on this machine") as on_progress:
        from sawmill_worker.commands.compile import compile_kernels

        compile_kernels(on_progress)
