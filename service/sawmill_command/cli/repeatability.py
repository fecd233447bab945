"""`sawmill repeatability`: flags and output."""
# ruff: noqa: PLC0415, FBT002 - imports inside the command: its help needs none; flags are booleans with a default

from pathlib import Path
from typing import Annotated

import typer

from sawmill_worker.commands import options as shared
from sawmill_worker.commands.terminal import Command, answering, print_json

app = typer.Typer()


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
        from sawmill_calibration.calibration.repeatability import repeatability as compared
        from sawmill_calibration.result_file import read_calibration

        result = compared([(str(path), read_calibration(path)) for path in results])
    if as_json:
        print_json({"state": "succeeded", **result.model_dump(mode="json")})
    else:
        from sawmill_worker.commands.tables import print_repeatability

        print_repeatability(result)
