"""The commands that need no server: from inspect and calibrate to export and worker.

Here stand their flags and what they print. Flags come from the contracts (`commands/from_contract.py`). What a
command does stands in `sawmill_worker.commands`. The command itself imports it: none waits for another's libraries.
"""
# ruff: noqa: PLC0415, FBT002 - imports inside the commands, for that reason; flags are booleans with a default

import os
from pathlib import Path
from typing import Annotated, ClassVar

import typer

from sawmill_worker.commands import options as shared
from sawmill_worker.commands.command_line import Command, OneOf
from sawmill_worker.commands.from_contract import Flags, from_contracts, option, wrong_use
from sawmill_worker.commands.inspection_table import print_inspection
from sawmill_worker.commands.options import CalibrationSource, Pictures, ThetaSource, scan_source
from sawmill_worker.commands.tables import (
    print_calibration,
    print_drift,
    print_plans,
    print_repeatability,
    report_method,
)
from sawmill_worker.commands.terminal import answering, print_json, say, showing_progress
from sawmill_worker.contracts.calibrations import CalibrationFile, CalibrationOptions
from sawmill_worker.contracts.drifts import DriftOptions
from sawmill_worker.contracts.geometry import ScannerConstants
from sawmill_worker.contracts.jobs import JobKind
from sawmill_worker.contracts.plans import PlanOptions
from sawmill_worker.contracts.reconstructions import ReconstructionOptions
from sawmill_worker.contracts.scanners import ScannerSpec, Tolerances
from sawmill_worker.contracts.simulating import SimulationOptions
from sawmill_worker.execution.importing import importing
from sawmill_worker.readers.angles import AngleSteps
from sawmill_worker.vocabulary import CalibrationMethod, DataKind, Handedness, ReconstructionMethod, Rotation, Theta
from sawmill_worker.vocabulary.version import VERSION

app = typer.Typer(no_args_is_help=True, pretty_exceptions_show_locals=False)
phantom_app = typer.Typer(no_args_is_help=True)
app.add_typer(phantom_app, name="phantom", help="Choose a phantom, and draw it.")


class WithGeometry(Command):
    """Needs a geometry, as five numbers or as a calibration."""

    one_of = OneOf(("theta", "calibration"), "the geometry")
    needs: ClassVar = {"theta": "source_to_cor_mm"}


class WithAngles(Command):
    """Needs the angles of the views."""

    one_of = OneOf(("angles_deg", "angles_file"), "the views' angles")


def _print_version(asked: bool) -> None:  # noqa: FBT001 - Typer's callback
    if asked:
        typer.echo(VERSION)
        raise typer.Exit


@app.callback()
def sawmill(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Geometry calibration and reconstruction for sawmill X-ray log scanners."""


@app.command(cls=Command)
def inspect(
    file: shared.ScanFile,
    data: Annotated[DataKind | None, option(shared.ScanOptions, "data")] = None,
    dataset: Annotated[str | None, option(shared.ScanOptions, "dataset")] = None,
    angles_deg: shared.AnglesDeg = None,
    angles_file: shared.AnglesFile = None,
    detector_pitch_mm: Annotated[float | None, option(shared.ScanOptions, "detector_pitch_mm")] = None,
    row_pitch_mm: Annotated[float | None, option(shared.ScanOptions, "row_pitch_mm")] = None,
    follow_links: Annotated[bool, option(shared.ScanOptions, "follow_links", flag="--follow-links")] = False,
    transpose: Annotated[bool, option(shared.ScanOptions, "transpose", flag="--transpose")] = False,
    flats: shared.FlatsFile = None,
    darks: shared.DarksFile = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Say what is in a file, what of it would be read as a scan, and what is missing."""
    angles = shared.given_angles(angles_deg, angles_file)
    with answering(as_json=as_json):
        from sawmill_worker.use_cases.inspect import GivenBeside, inspect_file

        result = inspect_file(
            GivenBeside(
                file, data, dataset, angles, detector_pitch_mm, row_pitch_mm, flats, darks, follow_links, transpose
            ),
        )
    if as_json:
        print_json({"state": "succeeded", **result.model_dump(mode="json")})
    else:
        print_inspection(result)


@app.command(cls=Command)
@from_contracts
def calibrate(
    scan: shared.ScanFile,
    reading: shared.ScanFlags,
    source_to_cor_mm: shared.SourceToCor,
    phantom: shared.PhantomText,
    options: Annotated[CalibrationOptions, Flags(rows=shared.ROWS)],
    phantom_width_mm: shared.PhantomWidth = None,
    tolerance_scale_percent: Annotated[float, option(Tolerances, "scale_percent")] = 0.5,
    log_radius_mm: Annotated[float | None, option(ScannerSpec, "log_radius_mm")] = None,
    report: Annotated[Path | None, shared.ReportFlag] = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Find the geometry from a scan of a phantom."""
    if options.paper.model_fields_set and options.method is not CalibrationMethod.PAPER:
        [flag, *_] = options.paper.model_fields_set
        raise typer.BadParameter(f"--paper-{flag.replace('_', '-')} comes with --method paper.")
    source = scan_source(scan, reading, views=options.views, rows=options.rows)
    drawn = shared.PhantomSource(phantom, phantom_width_mm)
    with answering(as_json=as_json), showing_progress("calibrate") as progress:
        from sawmill_worker.commands.calibrate import calibrate_scan

        result = calibrate_scan(
            source,
            drawn,
            options,
            source_to_cor_mm=source_to_cor_mm,
            scale_tolerance_percent=tolerance_scale_percent,
            log_radius_mm=log_radius_mm,
            picture=report,
            on_progress=progress,
        )
    if as_json:
        print_json(CalibrationFile.of(result).model_dump(mode="json"))
    else:
        print_calibration(result)


@app.command(cls=Command)
def report(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT",
            exists=True,
            dir_okay=False,
            help="A calibration's result.h5, or its RESULT.json, which has no pictures of the scan.",
        ),
    ],
    output: shared.Result,
) -> None:
    """Write a calibration's report as one HTML page that prints on A4."""
    with answering():
        from sawmill_worker.commands.report import write_report

        has_pictures = write_report(result, output)
    if not has_pictures:
        say(f"{result.name} has the numbers alone: the report has no pictures of the scan; result.h5 has them")
    say(f"a report of two pages: {output}")


@app.command(cls=Command)
def repeatability(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT.json",
            exists=True,
            dir_okay=False,
            help="RESULT.json or result.h5 of two or more calibrations of one scanner.",
        ),
    ],
    as_json: shared.JsonFlag = False,
) -> None:
    """Report what calibrations of one scanner differ by, against their error bars."""
    with answering(as_json=as_json):
        from sawmill_worker.use_cases.repeatability import repeatability as compared
        from sawmill_worker.use_cases.result_file import read_calibration

        result = compared([(str(path), read_calibration(path)) for path in results])
    if as_json:
        print_json({"state": "succeeded", **result.model_dump(mode="json")})
    else:
        print_repeatability(result)


@app.command(cls=WithGeometry)
@from_contracts
def drift(
    scan: shared.ScanFile,
    reading: shared.ScanFlags,
    options: Annotated[DriftOptions, Flags(rows=shared.ROWS)],
    calibration: Annotated[Path | None, shared.CalibrationFlag] = None,
    theta: Annotated[Theta | None, shared.ThetaFlag] = None,
    source_to_cor_mm: shared.SourceToCorOfTheta = None,
    rotation: shared.RotationOfTheta = None,
    views: Annotated[int | None, option(CalibrationOptions, "views")] = None,
    baseline: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="RESULT.json",
            exists=True,
            dir_okay=False,
            help="What drift --json printed of one of the first logs after the calibration, three or more, the flag "
            "once for each: what they measured is the zero of the change.",
        ),
    ] = None,
    tolerance_mm: Annotated[float, option(Tolerances, "ray_change_mm")] = 0.5,
    as_json: shared.JsonFlag = False,
) -> None:
    """Report what moved since a calibration, from any scan of a log with 8 views or more, without a phantom.

    With --theta of nominal distances in place of a calibration, report where the centre of rotation is.
    """
    if theta is not None and baseline:
        raise typer.BadParameter("--baseline comes with --calibration: nominal distances have no earlier checks.")
    geometry = _geometry(theta, rotation, calibration, source_to_cor_mm)
    source = scan_source(scan, reading, views=views, rows=options.rows)
    with answering(as_json=as_json), showing_progress("drift") as progress:
        from sawmill_worker.commands.drift import check_drift

        result = check_drift(source, geometry, baseline=baseline or (), tolerance_mm=tolerance_mm, on_progress=progress)
    if as_json:
        print_json({"state": "succeeded", **result.model_dump(mode="json")})
    else:
        print_drift(result)


@app.command(cls=WithGeometry)
@from_contracts
def reconstruct(
    scan: shared.ScanFile,
    reading: shared.ScanFlags,
    output: shared.Result,
    options: Annotated[
        ReconstructionOptions,
        Flags(
            rows=shared.STEPPED_ROWS,
            size={"parser": shared.one_number, "metavar": "INTEGER"},
            field_mm={"parser": shared.one_number, "metavar": "FLOAT"},
            field_centre_mm={"parser": shared.coordinates_of, "metavar": "X,Y", "default": "0,0"},
        ),
    ],
    theta: Annotated[Theta | None, shared.ThetaFlag] = None,
    source_to_cor_mm: shared.SourceToCorOfTheta = None,
    rotation: shared.RotationOfTheta = None,
    calibration: Annotated[Path | None, shared.CalibrationFlag] = None,
    png: Annotated[Path | None, shared.picture("Write a picture of the middle slice.")] = None,
    mosaic: Annotated[Path | None, shared.picture("Write a picture of slices along the log.")] = None,
    side: Annotated[Path | None, shared.picture("Write what is densest, from the side.")] = None,
    alpha_curve: Annotated[Path | None, shared.picture("Write how tikhonov's alpha was chosen.")] = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Reconstruct each row of a scan."""
    geometry = _geometry(theta, rotation, calibration, source_to_cor_mm)
    if alpha_curve is not None and options.method is not ReconstructionMethod.TIKHONOV:
        raise typer.BadParameter("--alpha-curve is a picture of --method tikhonov.")
    source = scan_source(scan, reading, views=options.views, rows=options.rows)
    with answering(as_json=as_json), showing_progress("reconstruct") as progress:
        from sawmill_worker.commands.reconstruct import reconstruct_scan

        result = reconstruct_scan(
            source,
            geometry,
            options,
            output=output,
            pictures=Pictures(png, mosaic, side, alpha_curve),
            on_progress=progress,
        )
    if as_json:
        print_json({"state": "succeeded", "output": str(output), **result.model_dump(mode="json")})
    slices, width, _ = result.shape
    say(f"{slices} slice(s) of {width} x {width} pixels in {result.time_s:.2f} s: {output}")
    if result.method is not None:
        report_method(result.method)


def _geometry(
    theta: Theta | None, rotation: Rotation | None, calibration: Path | None, source_to_cor_mm: float | None
) -> ThetaSource | CalibrationSource:
    if calibration is None:
        assert theta is not None  # noqa: S101 - WithGeometry saw to it
        assert source_to_cor_mm is not None  # noqa: S101
        return ThetaSource(theta, rotation or Rotation.AS_GIVEN, source_to_cor_mm)
    if rotation is not None:
        raise typer.BadParameter("--rotation comes with --theta; a calibration carries its own.")
    return CalibrationSource(calibration, source_to_cor_mm)


@app.command(cls=Command)
@from_contracts
def simulate(
    body: Annotated[
        str,
        typer.Argument(
            metavar="BODY",
            callback=shared.body,
            autocompletion=shared.body_names,
            help="A phantom (as --phantom), log, or log-with-phantom, whose first rows show a phantom.",
        ),
    ],
    theta: Annotated[Theta, shared.ThetaFlag],
    output: shared.Result,
    scanner: Annotated[ScannerConstants, Flags(**shared.PUBLISHED_SCANNER, row_pitch_mm={"default": 2.0})],
    data: Annotated[DataKind, option(shared.ScanOptions, "data")] = DataKind.COUNTS,
    angles_deg: Annotated[
        str | None, typer.Option(metavar="START:STEP", help="A full turn from half a step by default.")
    ] = None,
    angles_file: shared.AnglesFile = None,
    views: Annotated[int, option(SimulationOptions, "views", min=3)] = 360,
    rows: Annotated[int, option(SimulationOptions, "rows")] = 1,
    phantom: shared.PhantomText = "l-shape",
    phantom_width_mm: shared.PhantomWidth = None,
    phantom_rows: Annotated[int, typer.Option(min=1, help="Rows of log-with-phantom that show the phantom.")] = 4,
    position_mm: Annotated[
        shared.Position | None,
        typer.Option(parser=shared.position_of, metavar="X,Y", help="Where the phantom stands. By default 0,0."),
    ] = None,
    handedness: Annotated[Handedness, typer.Option(help="From which end it is seen.")] = Handedness.AS_DRAWN,
    rotation: Annotated[Rotation, typer.Option(help="Which way the angles count.")] = Rotation.AS_GIVEN,
    noise: Annotated[float, option(SimulationOptions, "noise")] = 0.0,
    background: Annotated[float, option(SimulationOptions, "background")] = 0.0,
    photons: Annotated[float, option(SimulationOptions, "photons")] = 30_000.0,
    seed: Annotated[int, option(SimulationOptions, "seed")] = 1,
    physics: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            exists=True,
            dir_okay=False,
            help="Of counts: JSON of what the beam, the detector, the motion and the wood add (docs/simulating.md).",
        ),
    ] = None,
) -> None:
    """Simulate a scan of a phantom or a synthetic log, analytically, seeded."""
    angles = shared.given_angles(angles_deg, angles_file) or AngleSteps(180.0 / views, 360.0 / views)
    if body == shared.Body.LOG_WITH_PHANTOM and phantom_rows >= rows:
        raise typer.BadParameter(f"--phantom-rows {phantom_rows} leaves no row for the log: give more --rows.")
    if physics is not None and data is not DataKind.COUNTS:
        raise typer.BadParameter("--physics makes counts: leave --data line-integrals out.")
    drawn = shared.PhantomSource(phantom if body in set(shared.Body) else body, phantom_width_mm)
    with answering():
        from sawmill_worker.commands.simulate import phantom_slices, simulate_scan
        from sawmill_worker.tomography.log_model import log_slices

        wood = 0 if body == shared.Body.LOG else phantom_rows if body == shared.Body.LOG_WITH_PHANTOM else rows
        as_wood = data is DataKind.COUNTS or body == shared.Body.LOG_WITH_PHANTOM
        slices = phantom_slices(
            drawn, wood, handedness=handedness, position=position_mm or shared.Position(), as_wood=as_wood
        )
        slices += log_slices(rows, row_pitch_mm=scanner.row_pitch_mm or 0.0, seed=seed)[wood:]
        simulate_scan(
            output,
            slices,
            data=data,
            scanner=scanner,
            theta=theta,
            rotation=rotation,
            angles=angles,
            views=views,
            noise=noise,
            background=background,
            photons=photons,
            seed=seed,
            physics=physics,
        )
    say(f"{views} views, {rows} row(s), {scanner.num_detector_pixels} cells: {output}")


@app.command(cls=WithAngles)
def export(
    calibration: Annotated[Path, shared.CalibrationFlag],
    to: Annotated[
        shared.ExportTarget,
        typer.Option(
            help="astra: rows srcX srcY dX dY uX uY of fanflat_vec, mm; odl, cil: JSON of every argument; rtk: XML.",
        ),
    ],
    output: shared.Result,
    views: Annotated[int, typer.Option(min=1, help="Number of views.")],
    angles_deg: shared.AnglesDeg = None,
    angles_file: shared.AnglesFile = None,
) -> None:
    """Write a calibrated geometry for another toolkit."""
    angles = shared.given_angles(angles_deg, angles_file)
    assert angles is not None  # noqa: S101 - WithAngles saw to it
    with answering():
        from sawmill_worker.commands.export import export_geometry

        export_geometry(to, calibration, output, angles, views)
    say(f"{views} views: {output}")


@phantom_app.command(cls=Command)
@from_contracts
def plan(
    phantoms: Annotated[
        list[str],
        typer.Argument(
            metavar="PHANTOM...",
            callback=shared.phantoms,
            autocompletion=shared.phantom_names,
            help="What to compare: names or files, as --phantom.",
        ),
    ],
    theta: Annotated[Theta, shared.ThetaFlag],
    scanner: Annotated[ScannerConstants, Flags(**shared.PUBLISHED_SCANNER, row_pitch_mm=None)],
    views: Annotated[
        list[int] | None, typer.Option(min=3, help="Views over a full turn; may be repeated. 20 and 360 by default.")
    ] = None,
    noise: Annotated[float, option(PlanOptions, "noise")] = 0.02,
    size_tolerance_percent: Annotated[float | None, option(PlanOptions, "size_tolerance_percent")] = None,
    log_radius_mm: Annotated[float | None, option(ScannerSpec, "log_radius_mm")] = None,
    phantom_width_mm: shared.PhantomWidth = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Predict how well phantoms will calibrate a scanner, before they are made."""
    drawn = [shared.PhantomSource(text, phantom_width_mm) for text in phantoms]
    with wrong_use():
        options = [
            PlanOptions(views=count, noise=noise, size_tolerance_percent=size_tolerance_percent)
            for count in views or (20, 360)
        ]
    with answering(as_json=as_json):
        from sawmill_worker.commands.phantom import plan_phantoms

        plans = plan_phantoms(drawn, options, scanner=scanner, theta=theta, log_radius_mm=log_radius_mm)
    if as_json:
        print_json({"state": "succeeded", "plans": [each.model_dump(mode="json") for each in plans]})
    else:
        print_plans(plans)
    for each in plans:
        if each.views_cut_off:
            say(f"{each.phantom}: {each.views_cut_off} of {each.views} views reach an end of the detector")


@phantom_app.command(cls=Command)
def draw(
    phantom: Annotated[
        str,
        typer.Argument(
            metavar="PHANTOM",
            callback=shared.phantom,
            autocompletion=shared.phantom_names,
            help="A name or a file, as --phantom.",
        ),
    ],
    output: shared.Result,
    phantom_width_mm: shared.PhantomWidth = None,
) -> None:
    """Draw a phantom as SVG in mm, to print at full size."""
    drawn = shared.PhantomSource(phantom, phantom_width_mm)
    with answering():
        from sawmill_worker.commands.phantom import draw_phantom

        draw_phantom(drawn, output)
    say(f"{phantom}, to be printed at 100 %: {output}")


@app.command(cls=Command)
def worker(
    data: Annotated[
        Path | None, typer.Option("--data", help="Data folder; SAWMILL_DATA_FOLDER or the default otherwise.")
    ] = None,
    kinds: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND,...",
            callback=shared.job_kinds,
            help=f"Take jobs of these kinds alone: {', '.join(JobKind)}. May be repeated. All by default.",
        ),
    ] = None,
    scanners: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SCANNER,...",
            callback=shared.listed,
            help="Take jobs of these scanners alone, by id or name, the id where the name has a comma. May be "
            "repeated. By default those of all, and those of none.",
        ),
    ] = None,
) -> None:
    """Run one embedded worker beside a service that uses the same data folder."""
    from sawmill_worker.execution.poller import run
    from sawmill_worker.execution.variables import WrongVariableError, variables_checked

    if data is not None:
        os.environ["SAWMILL_DATA_FOLDER"] = str(data)
    try:
        with variables_checked():
            run(kinds=kinds or (), scanners=scanners or ())
    except WrongVariableError as error:
        raise typer.BadParameter(str(error)) from error


@app.command(cls=Command)
def watch(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE.toml", help="Which folders, and where the service is (docs/watched-folder.md)."),
    ],
    once: Annotated[
        bool, typer.Option("--once", help="End when all that is whole has been read; exit code 1 if anything is left.")
    ] = False,
    check: Annotated[
        bool, typer.Option("--check", help="Say what would be done, and do nothing; exit code 1 if it would fail.")
    ] = False,
) -> None:
    """Watch folders for scanners that can only write files, and bring each scan to the service once."""
    with importing():
        from sawmill_worker.execution.logs import configure_logs
        from sawmill_worker.execution.settings import ExecutionSettings
        from sawmill_worker.execution.variables import WrongVariableError, variables_checked
        from sawmill_worker.watching import command
        from sawmill_worker.watching.settings import WrongFileError

    try:
        with variables_checked():
            configure_logs(ExecutionSettings().log_format)
        if check:
            found = command.check(file)
            for is_well, sentence in found:
                say(sentence, trouble=None if is_well else "wrong")
            raise typer.Exit(0 if all(is_well for is_well, _ in found) else 1)
        is_well = command.watch(file, showing_progress, once=once)
    except (WrongVariableError, WrongFileError) as error:
        raise typer.BadParameter(str(error)) from error
    except command.CannotWatch as error:
        say(str(error), trouble="cannot watch")
        raise typer.Exit(1) from error
    if once and not is_well:
        raise typer.Exit(1)


@app.command(name="compile", cls=Command)
def compile_() -> None:
    """Compile the numerical kernels now: once on a machine, else the first job waits for it."""
    with answering(), showing_progress("compiling kernels, once on this machine") as on_progress:
        from sawmill_worker.commands.compile import compile_kernels

        compile_kernels(on_progress)
