"""`sawmill drift`: flags and output."""
# ruff: noqa: PLC0415, FBT002 - imports inside the command: its help needs none; flags are booleans with a default

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from sawmill_contracts.calibrations import CalibrationOptions
from sawmill_contracts.drifts import DriftOptions
from sawmill_contracts.scanners import Tolerances
from sawmill_platform.attempts.importing import importing
from sawmill_vocabulary import Theta
from sawmill_worker.commands import geometry_options
from sawmill_worker.commands import options as shared
from sawmill_worker.commands.from_contract import Flags, from_contracts, option
from sawmill_worker.commands.terminal import answering, print_json, showing_progress

app = typer.Typer()


@app.command(cls=geometry_options.WithGeometry)
@from_contracts
def drift(
    scan: shared.ScanFile,
    reading: shared.ScanFlags,
    options: Annotated[DriftOptions, Flags(rows=shared.ROWS)],
    calibration: Annotated[Path | None, geometry_options.CalibrationFlag] = None,
    geometry: Annotated[Path | None, geometry_options.GeometryFlag] = None,
    theta: Annotated[Theta | None, geometry_options.ThetaFlag] = None,
    source_to_cor_mm: geometry_options.SourceToCorOfTheta = None,
    rotation: geometry_options.RotationOfTheta = None,
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
    if calibration is None and baseline:
        raise typer.BadParameter("--baseline comes with --calibration: nominal distances have no earlier checks.")
    known_by = geometry_options.GeometryFlags(theta, rotation, calibration, source_to_cor_mm, geometry)
    source = shared.scan_source(scan, reading, views=views, rows=options.rows)
    with answering(as_json=as_json), showing_progress("drift") as progress:
        with importing():
            from sawmill_calibration.drift_checks.baselines import baselines_of, read_answers
            from sawmill_calibration.drift_checks.drift_check import check_drift
            from sawmill_worker.commands.calibrated_scan import open_with_geometry

        with open_with_geometry(source, known_by, on_progress=progress) as (rows, known):
            baselines = baselines_of(read_answers(baseline), known, rows.sha256) if baseline else ()
            result = check_drift(rows, known, tolerance_mm=tolerance_mm, baselines=baselines).ended(datetime.now(UTC))
    if as_json:
        print_json({"state": "succeeded", **result.model_dump(mode="json")})
    else:
        from sawmill_worker.commands.tables import print_drift

        print_drift(result)
