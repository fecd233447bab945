"""`sawmill pack`: flags and output."""
# ruff: noqa: PLC0415, FBT002 - imports inside the command: its help needs none; flags are booleans with a default

import sys
from pathlib import Path
from typing import Annotated

import typer

from sawmill_contracts.geometry import ScannerConstants
from sawmill_worker.commands import options as shared
from sawmill_worker.commands.from_contract import Flags, from_contracts, option
from sawmill_worker.commands.terminal import Command, answering, print_json, say

app = typer.Typer()
OF_PREPARING = dict.fromkeys(("air", "faulty_cells", "rings", "align_rows", "averaged_rows"))
Drawing = typer.Option(metavar="FILE.json", exists=True, dir_okay=False, help="Drawing of the phantom in the scan.")


@app.command(cls=Command)
@from_contracts
def pack(
    scan: shared.ScanFile,
    reading: Annotated[shared.ScanOptions, Flags(**shared.OF_READING, **OF_PREPARING)],
    output: shared.Result,
    source_to_cor_mm: Annotated[float | None, option(ScannerConstants, "source_to_cor_mm")] = None,
    phantom: Annotated[Path | None, Drawing] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Write without asking; for scripts.")] = False,
    as_json: shared.JsonFlag = False,
) -> None:
    """Pack a scan for other people: images and geometry, without names, times, serial numbers and paths."""
    source = shared.scan_source(scan, reading, views=None, rows=None)
    if output.exists() and output.samefile(scan):
        raise typer.BadParameter(f"{output.name!r} is the scan itself: give another name.")
    with answering(as_json=as_json):
        from sawmill_calibration.failures import refused
        from sawmill_calibration.known_geometry import drawing_of
        from sawmill_calibration.scans.pack import packing
        from sawmill_worker.commands.tables import print_pack

        drawing = None if phantom is None else drawing_of(phantom)
        with packing(source, source_to_cor_mm=source_to_cor_mm, drawing=drawing) as packed:
            if not as_json:
                print_pack(packed)
            if not yes:
                say(f"Write this to {output}? [y/N]")
            if not yes and sys.stdin.readline().strip().lower() not in {"y", "yes"}:
                raise refused("not-confirmed", "nothing was written: answer y, or give --yes")
            packed.write(output)
    if as_json:
        lists = {"kept": packed.kept, "left_out": packed.left_out, "unknown": packed.unknown}
        print_json({"state": "succeeded", "output": str(output), **lists})
    say(f"packed: {output}; read it with --data {reading.data.value}")
