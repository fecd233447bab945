"""`sawmill inspect`: flags and output."""
# ruff: noqa: PLC0415, FBT002 - imports inside the command: its help needs none; flags are booleans with a default

from typing import Annotated

import typer

from sawmill_vocabulary import DataKind
from sawmill_worker.commands import options as shared
from sawmill_worker.commands.from_contract import option
from sawmill_worker.commands.terminal import Command, answering, print_json

app = typer.Typer()


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
    axes: Annotated[str | None, option(shared.ScanOptions, "axes")] = None,
    flats: shared.FlatsFile = None,
    darks: shared.DarksFile = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Say what is in a file, what of it would be read as a scan, and what is missing."""
    angles = shared.given_angles(angles_deg, angles_file)
    with answering(as_json=as_json):
        from sawmill_calibration.scans.inspect import InspectionInput, inspect_file

        given = InspectionInput(
            file, data, dataset, angles, detector_pitch_mm, row_pitch_mm, flats, darks, follow_links, transpose, axes
        )
        result = inspect_file(given)
    if as_json:
        print_json({"state": "succeeded", **result.model_dump(mode="json")})
    else:
        from sawmill_worker.commands.tables import print_inspection

        print_inspection(result)
