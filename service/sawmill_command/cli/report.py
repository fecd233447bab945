"""`sawmill report`: flags."""
# ruff: noqa: PLC0415 - imports inside the command: its help needs none

from pathlib import Path
from typing import Annotated

import typer

from sawmill_worker.commands import options as shared
from sawmill_worker.commands.terminal import Command, answering, say

app = typer.Typer()


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
