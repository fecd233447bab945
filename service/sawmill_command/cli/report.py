"""`sawmill report` and `sawmill budget`: flags and output."""
# ruff: noqa: PLC0415, FBT002 - imports inside the command: its help needs none; flags are booleans with a default

import math
from pathlib import Path
from typing import Annotated

import typer

from sawmill_vocabulary.uncertainty import StatedChange
from sawmill_worker.commands import options as shared
from sawmill_worker.commands.terminal import Command, answering, print_json, say

app = typer.Typer()
ResultFile = Annotated[
    Path,
    typer.Argument(
        metavar="RESULT",
        exists=True,
        dir_okay=False,
        help="A calibration's result.h5, or its RESULT.json, which has no pictures of the scan.",
    ),
]


@app.command(cls=Command)
def report(result: ResultFile, output: shared.Result) -> None:
    """Write a calibration's report as one HTML page that prints on A4."""
    with answering():
        from sawmill_worker.commands.report import write_report

        has_pictures = write_report(result, output)
    if not has_pictures:
        say(f"{result.name} has the numbers alone: the report has no pictures of the scan; result.h5 has them")
    say(f"a report to print: {output}")


def _change(text: str) -> StatedChange:
    """Parse a change since the phantom was measured."""
    parts = text.split(":")
    try:
        measured, scanned, uncertainty = map(float, [*parts, "1"] if len(parts) == 2 else parts)
    except ValueError:
        measured = scanned = uncertainty = math.nan
    if not (math.isfinite(measured + scanned + uncertainty) and uncertainty >= 0.0):
        raise typer.BadParameter(f"{text!r} must be MEASURED:SCANNED or MEASURED:SCANNED:UNCERTAINTY.")
    return StatedChange(measured, scanned, uncertainty)


def _stated(what: str) -> object:
    """Return the option of a stated change."""
    words = f"{what} at its measurement and at the scan, and the difference's standard uncertainty: 1 if left out."
    return typer.Option(parser=_change, metavar="MEASURED:SCANNED[:UNCERTAINTY]", help=words)


@app.command(cls=Command)
def budget(
    result: ResultFile,
    moisture_percent: Annotated[
        StatedChange | None, _stated("Moisture of the phantom's wood, against its dry weight,")
    ] = None,
    temperature_c: Annotated[StatedChange | None, _stated("Temperature of the phantom")] = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Report what a calibration's uncertainty is made of: each source, with its share in rays and millimetres."""
    stated = {"moisture": moisture_percent, "temperature": temperature_c}
    with answering(as_json=as_json):
        from sawmill_calibration.calibration.stated_changes import with_stated_changes
        from sawmill_calibration.failures import refused
        from sawmill_calibration.result_file import read_calibration
        from sawmill_worker.commands.tables import print_budget

        answer = read_calibration(result)
        if not answer.uncertainty_budget:
            raise refused("no-budget", f"{result.name} has no uncertainty budget: calibrate its scan again")
        if changes := {source: change for source, change in stated.items() if change is not None}:
            answer = with_stated_changes(answer, changes)
    if as_json:
        included = {"uncertainty_budget", "scale_uncertainty_percent", "predicted_ray_error_mm"}
        print_json({"state": "succeeded", **answer.model_dump(mode="json", include=included)})
    else:
        print_budget(answer)
