"""`sawmill calibrate-pairs` and `sawmill locate-marks`: flags and output."""
# ruff: noqa: PLC0415, FBT002 - imports inside the command: its help needs none; flags are booleans with a default

from pathlib import Path
from typing import Annotated

import typer

from sawmill_contracts.fixed_pairs import FixedPairsOptions
from sawmill_vocabulary import DataKind
from sawmill_worker.commands import options as shared
from sawmill_worker.commands.from_contract import Flags, from_contracts, option
from sawmill_worker.commands.options import PhantomText, PhantomWidth, check_width
from sawmill_worker.commands.terminal import Command, answering, print_json, showing_progress

app = typer.Typer()
PairsFile = typer.Argument(
    metavar="PAIRS.json", exists=True, dir_okay=False, help="The nominal places of the pairs (docs/do/fixed-pairs.md)."
)
PairScans = typer.Argument(
    metavar="SCAN...",
    exists=True,
    help="A file for each pair, in their order: views are passages, rows the feed; such files of more passages.",
)
ReportFlag = typer.Option(
    metavar="OUT.png", dir_okay=False, callback=shared.writable, help="Draw the ring of pairs with the error of each."
)
Calibrated = typer.Argument(
    metavar="CALIBRATED.json", exists=True, dir_okay=False, help="What `calibrate-pairs --json` printed."
)
LogScans = typer.Argument(metavar="SCAN...", exists=True, help="A file for each pair, in their order, of one log.")
Tolerance = typer.Option(min=0.01, max=100, help="The pairs agree where none can have moved by more than this.")
AlignedFlag = typer.Option(
    metavar="OUT.h5",
    dir_okay=False,
    callback=shared.writable,
    help="Write the log's rows by all pairs as one scan, and OUT.json: its --geometry for `sawmill reconstruct`.",
)


@app.command(cls=Command)
@from_contracts
def calibrate_pairs(
    pairs: Annotated[Path, PairsFile],
    scans: Annotated[list[Path], PairScans],
    data: Annotated[DataKind, option(shared.ScanOptions, "data")],
    phantom: PhantomText,
    options: Annotated[FixedPairsOptions, Flags()],
    phantom_width_mm: PhantomWidth = None,
    report: Annotated[Path | None, ReportFlag] = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Find the geometry of all pairs of a scanner of fixed pairs, from passages of one board."""
    check_width(phantom, phantom_width_mm)
    with answering(as_json=as_json), showing_progress("calibrate") as progress:
        from sawmill_calibration.calibration.fixed_pairs import calibrate_fixed_pairs
        from sawmill_calibration.known_geometry import drawing_of

        drawing = drawing_of(phantom, phantom_width_mm)
        result = calibrate_fixed_pairs(scans, pairs, drawing, data=data, options=options, on_progress=progress)
        if report is not None:
            from sawmill_calibration.pictures.ring_of_pairs import ring_png

            report.write_bytes(ring_png(result))
    if as_json:
        print_json(result.model_dump(mode="json"))
    else:
        from sawmill_worker.commands.tables import print_pairs

        print_pairs(result)


@app.command(cls=Command)
@from_contracts
def locate_marks(
    pairs: Annotated[Path, PairsFile],
    calibrated: Annotated[Path, Calibrated],
    scans: Annotated[list[Path], LogScans],
    data: Annotated[DataKind, option(shared.ScanOptions, "data")],
    tolerance_mm: Annotated[float, Tolerance] = 1.0,
    aligned: Annotated[Path | None, AlignedFlag] = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Find a log's nails and stones in three dimensions on a scanner of fixed pairs, and check the pairs by it."""
    with answering(as_json=as_json), showing_progress("marks") as progress:
        from sawmill_calibration.drift_checks import pair_logs

        log = pair_logs.locate_marks(
            scans, pairs, calibrated, data=data, tolerance_mm=tolerance_mm, aligned=aligned, on_progress=progress
        )
    if as_json:
        print_json(log.model_dump(mode="json"))
    else:
        from sawmill_worker.commands.tables import print_marks

        print_marks(log)
