"""`sawmill worker`: flags."""
# ruff: noqa: PLC0415 - imports inside the command: its help needs none

import os
from typing import Annotated

import typer

from sawmill_command.data_option import Data, wrong_variables_refused
from sawmill_contracts import kinds as job_kinds  # noqa: F401 - registers the kinds
from sawmill_platform.contracts.jobs import JobKind
from sawmill_worker.commands.terminal import Command

app = typer.Typer()


def _listed(texts: list[str] | None) -> list[str]:
    """Split texts at commas (a Typer callback)."""
    return [part.strip() for text in texts or () for part in text.split(",")]


def _job_kinds(texts: list[str] | None) -> list[str]:
    """Split kinds of jobs, and refuse unknown kinds (a Typer callback)."""
    kinds = _listed(texts)
    for kind in kinds:
        if kind not in set(JobKind.all()):
            raise typer.BadParameter(f"{kind!r} is no kind of job: {', '.join(JobKind.all())}.")
    return kinds


@app.command(cls=Command)
def worker(
    data: Data = None,
    kinds: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND,...",
            callback=_job_kinds,
            help=f"Take jobs of these kinds alone: {', '.join(JobKind.all())}. May be repeated. All by default.",
        ),
    ] = None,
    scanners: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SCANNER,...",
            callback=_listed,
            help="Take jobs of these scanners alone, by id or name, the id where the name has a comma. May be "
            "repeated. By default those of all, and those of none.",
        ),
    ] = None,
) -> None:
    """Run one embedded worker next to a service that uses the same data folder."""
    from sawmill_worker.poller import run

    if data is not None:
        os.environ["SAWMILL_DATA_FOLDER"] = str(data)
    with wrong_variables_refused():
        run(kinds=kinds or (), scanners=scanners or ())
