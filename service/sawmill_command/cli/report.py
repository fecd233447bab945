"""`sawmill report` and `sawmill budget`: flags and output."""
# ruff: noqa: PLC0415, FBT002 - imports inside the command: its help needs none; flags are booleans with a default

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from sawmill_worker.commands import options as shared
from sawmill_worker.commands.terminal import Command, answering, print_json, say

app = typer.Typer()
Change = tuple[float, float, float] | None
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


def _checked(change: Change) -> Change:
    """Refuse numbers that state no change."""
    if change is not None and not (math.isfinite(sum(change)) and change[2] >= 0.0):
        raise typer.BadParameter("must be three finite numbers, the last one not negative.")
    return change


CHANGE: dict[str, Any] = {"callback": _checked, "metavar": "MEASURED SCANNED UNCERTAINTY"}
WORDS = "of the phantom when it was measured, at the scan, and the standard uncertainty of the difference."


@app.command(cls=Command)
def budget(
    result: ResultFile,
    moisture_percent: Annotated[Change, typer.Option(help=f"Moisture {WORDS}", **CHANGE)] = None,
    temperature_c: Annotated[Change, typer.Option(help=f"Temperature {WORDS}", **CHANGE)] = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Report what a calibration's uncertainty is made of: each source, with its share in rays and millimetres."""
    with answering(as_json=as_json):
        from sawmill_calibration.calibration.stated_changes import with_stated_changes
        from sawmill_calibration.failures import refused
        from sawmill_calibration.result_file import read_calibration
        from sawmill_worker.commands.tables import print_budget

        before = read_calibration(result)
        if not before.uncertainty_budget:
            raise refused("no-budget", f"{result.name} has no uncertainty budget: calibrate its scan again")
        answer = with_stated_changes(before, moisture=moisture_percent, temperature=temperature_c)
    if as_json:
        print_json({"state": "succeeded", **answer.model_dump(mode="json", include={"uncertainty_budget"})})
    else:
        print_budget(answer)
