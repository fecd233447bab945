"""`sawmill locate-marks`: flags and output."""
# ruff: noqa: PLC0415, FBT002 - imports inside the command: its help needs none; flags are booleans with a default

from pathlib import Path
from typing import Annotated

import typer

from sawmill_command.cli.calibrate_pairs import PairsFile
from sawmill_vocabulary import DataKind
from sawmill_worker.commands import options as shared
from sawmill_worker.commands.from_contract import from_contracts, option
from sawmill_worker.commands.terminal import Command, answering, print_json, showing_progress

app = typer.Typer()
Calibrated = typer.Argument(
    metavar="CALIBRATED.json", exists=True, dir_okay=False, help="What `calibrate-pairs --json` printed."
)
LogScans = typer.Argument(metavar="SCAN...", exists=True, help="A file for each pair, in their order, of one log.")
Tolerance = typer.Option(min=0.01, max=100, help="The pairs agree where none can have moved by more than this.")
Aligned = typer.Option(
    metavar="OUT.h5",
    dir_okay=False,
    callback=shared.writable,
    help="Write the log's rows by all pairs as one scan, and OUT.json: its --geometry for `sawmill reconstruct`.",
)


@app.command(cls=Command)
@from_contracts
def locate_marks(
    pairs: Annotated[Path, PairsFile],
    calibrated: Annotated[Path, Calibrated],
    scans: Annotated[list[Path], LogScans],
    data: Annotated[DataKind, option(shared.ScanOptions, "data")],
    tolerance_mm: Annotated[float, Tolerance] = 1.0,
    aligned: Annotated[Path | None, Aligned] = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Find a log's nails and stones in three dimensions on a scanner of fixed pairs, and check the pairs by it."""
    with answering(as_json=as_json), showing_progress("marks") as progress:
        from dataclasses import asdict

        from sawmill_calibration.drift_checks.pair_logs import locate_marks as located
        from sawmill_worker.commands.tables import print_marks

        files = scans, pairs, calibrated
        log = located(*files, data=data, tolerance_mm=tolerance_mm, aligned=aligned, on_progress=progress)
    if as_json:
        print_json(asdict(log))
    else:
        print_marks(log)
