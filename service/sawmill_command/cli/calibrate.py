"""`sawmill calibrate`: flags and output."""
# ruff: noqa: PLC0415, FBT002 - imports inside the command: its help needs none; flags are booleans with a default

from pathlib import Path
from typing import Annotated

import typer

from sawmill_contracts.calibrations import CalibrationFile, CalibrationLimits, CalibrationOptions
from sawmill_contracts.scanners import ScannerSpec, Tolerances
from sawmill_platform.attempts.importing import importing
from sawmill_vocabulary import CalibrationMethod
from sawmill_worker.commands import options as shared
from sawmill_worker.commands.from_contract import Flags, from_contracts, option
from sawmill_worker.commands.options import PhantomText, PhantomWidth, check_width
from sawmill_worker.commands.terminal import Command, answering, print_json, showing_progress

app = typer.Typer()
ReportFlag = typer.Option(
    metavar="OUT.html",
    dir_okay=False,
    callback=shared.writable,
    help="Write a report: OUT.html is a page that prints on A4, OUT.png one picture.",
)


@app.command(cls=Command)
@from_contracts
def calibrate(
    scan: shared.ScanFile,
    reading: shared.ScanFlags,
    source_to_cor_mm: shared.SourceToCor,
    phantom: PhantomText,
    options: Annotated[CalibrationOptions, Flags(rows=shared.ROWS)],
    phantom_width_mm: PhantomWidth = None,
    tolerance_scale_percent: Annotated[float, option(Tolerances, "scale_percent")] = 0.5,
    log_radius_mm: Annotated[float | None, option(ScannerSpec, "log_radius_mm")] = None,
    report: Annotated[Path | None, ReportFlag] = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Find the geometry from a scan of a phantom."""
    if options.paper.model_fields_set and options.method is not CalibrationMethod.PAPER:
        [flag, *_] = options.paper.model_fields_set
        raise typer.BadParameter(f"--paper-{flag.replace('_', '-')} comes with --method paper.")
    source = shared.scan_source(scan, reading, views=options.views, rows=options.rows)
    check_width(phantom, phantom_width_mm)
    limits = CalibrationLimits(scale_tolerance_percent=tolerance_scale_percent, log_radius_mm=log_radius_mm)
    with answering(as_json=as_json), showing_progress("calibrate") as progress:
        with importing():
            from sawmill_calibration.calibration.calibrate_scan import calibrate_scan
            from sawmill_calibration.known_geometry import drawing_of
            from sawmill_calibration.scans.scan_rows import open_rows

        drawing = drawing_of(phantom, phantom_width_mm)
        with open_rows(source, source_to_cor_mm=source_to_cor_mm, on_progress=progress) as rows:
            made = calibrate_scan(rows, drawing, options, limits)
            result = made.result()
            if report is not None:
                from sawmill_worker.commands.report import write_report_of_scan

                write_report_of_scan(report, result, made.arrays(), scan.name, drawing)
    if as_json:
        print_json(CalibrationFile.of(result).model_dump(mode="json"))
    else:
        from sawmill_worker.commands.tables import print_calibration

        print_calibration(result)
