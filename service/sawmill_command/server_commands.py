"""`sawmill serve`, `migrate`, `doctor`, `install-service`, `demo` and `openapi`."""
# ruff: noqa: PLC0415 - imports inside the commands: a command loads only its libraries

import os
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from sawmill_command.data_option import Data, wrong_variables_refused
from sawmill_platform.attempts.importing import importing
from sawmill_worker.commands.terminal import Command, OneOf, print_json, say

app = typer.Typer()


@app.command(cls=Command)
def serve(
    data: Data = None,
    host: Annotated[
        str | None, typer.Option(help="Address to listen on; loopback by default, another needs SAWMILL_TOKEN.")
    ] = None,
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="8000 by default; 0 takes a free one.")] = None,
    workers: Annotated[
        int | None, typer.Option(min=0, max=64, help="Embedded workers; 0 leaves the work to others.")
    ] = None,
    examples: Annotated[bool, typer.Option(help="Put example resources into a fresh data folder.")] = True,  # noqa: FBT002 - a flag
) -> None:
    """Run the API, its workers and the schedule on this machine."""
    with importing():
        from sawmill_command.seeding import seed_examples
        from sawmill_platform.errors import StorageError
        from sawmill_platform.settings import StorageSettings
        from sawmill_platform.workers.settings import ExecutionSettings
        from sawmill_service.http.listening import ListenError
        from sawmill_service.serving import serve_until_stopped
        from sawmill_service.settings import ServiceSettings

    for name, value in (("DATA_FOLDER", data), ("HOST", host), ("PORT", port), ("WORKERS", workers or None)):
        if value is not None:
            os.environ[f"SAWMILL_{name}"] = str(value)
    with wrong_variables_refused():
        settings, storage, execution = ServiceSettings(), StorageSettings(), ExecutionSettings()
    seed = seed_examples if examples else None
    # The database has the secrets of webhooks in clear.
    os.umask(0o077)
    try:
        serve_until_stopped(settings, storage, execution, workers=workers != 0, seed=seed)
    except (ListenError, StorageError, OSError) as error:
        say(str(error), trouble="The service cannot start")
        raise typer.Exit(1) from error


@app.command(cls=Command)
def migrate(data: Data = None) -> None:
    """Make the database's tables, or bring them up to date, and end: what every start of the service does first."""
    from sawmill_command.key_commands import opened

    with opened(data) as store:
        report = store.database_report()
    say(f"{report.system} has the tables of version {report.migration}.")


@app.command(cls=Command)
def doctor(
    data: Annotated[
        # The doctor reports whether the folder can be read.
        Path | None, typer.Option(readable=False, help="Data folder; SAWMILL_DATA_FOLDER or the default otherwise.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,  # noqa: FBT002 - a flag
) -> None:
    """Check everything that the service needs, and say what to do about each problem.

    Nothing is changed. The exit code is 1 if a finding is bad.
    """
    from sawmill_command.doctor import command

    findings = command.examine(data)
    if as_json:
        print_json({"findings": [finding._asdict() for finding in findings]})
    else:
        command.show(findings)
    raise typer.Exit(1 if any(finding.state == "bad" for finding in findings) else 0)


class WithUnits(Command):
    """A command that prints the units or writes them to a folder."""

    one_of = OneOf(("printed", "to"), "what becomes of the units")


@app.command(cls=WithUnits)
def install_service(
    printed: Annotated[bool, typer.Option("--print", help="Print the units.")] = False,  # noqa: FBT002 - a flag
    to: Annotated[
        Path | None,
        typer.Option(exists=True, file_okay=False, help="Write the units into a folder, as /etc/systemd/system."),
    ] = None,
    data: Annotated[Path, typer.Option(readable=False, resolve_path=True, help="The service's data folder.")] = Path(
        "/var/lib/sawmill"
    ),
    user: Annotated[str, typer.Option(help="As whom the service runs.")] = "sawmill",
    token: Annotated[
        Path | None,
        typer.Option(
            readable=False, resolve_path=True, help="File of the token, which root alone need be able to read."
        ),
    ] = None,
    watch: Annotated[
        list[Path] | None,
        typer.Option(readable=False, help="Folder in which scanners may have watched folders; may be repeated."),
    ] = None,
) -> None:
    """Make systemd units for this installation: the service, and more workers and nightly backups.

    Nothing is started. What to do next is written to standard error.
    """
    from sawmill_command.service_units import Installation, program

    try:
        installation = Installation(program(), data, user, token, tuple(watch or ()))
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    if printed:
        for name, text in installation.units().items():
            typer.echo(f"# {name}\n{text}")
    if to is not None:
        try:
            written = installation.write(to)
        except OSError as error:
            say(str(error), trouble="The units cannot be written")
            raise typer.Exit(1) from error
        say(f"written: {', '.join(map(str, written))}")
    for doubt in installation.doubts():
        say(doubt, trouble="The service may not start")
    say("\n".join(["", "Next, as root:", *(f"  {step}" for step in installation.next_steps(written=to is not None))]))


@app.command(cls=Command)
def demo(
    output: Annotated[
        Path, typer.Option(file_okay=False, help="Folder for the pictures, the HDF5 files and index.html.")
    ] = Path("demo-output"),
) -> None:
    """Run the whole job over HTTP on simulated data."""
    from sawmill_command.demo import run_demo

    raise typer.Exit(run_demo(output))


@app.command(cls=Command)
def openapi(
    folder: Annotated[Path, typer.Option(file_okay=False, help="Where openapi.json and requests/ are written.")] = Path(
        "openapi"
    ),
) -> None:
    """Write the OpenAPI document and its example requests."""
    from sawmill_platform.settings import StorageSettings
    from sawmill_service.app import create_app
    from sawmill_service.http.document import openapi_document
    from sawmill_service.serving import no_wake
    from sawmill_service.settings import ServiceSettings
    from sawmill_store.store import Store

    with tempfile.TemporaryDirectory() as temporary:
        store = Store.open(StorageSettings(data_folder=Path(temporary), database_url=None))
        openapi_document.write(create_app(ServiceSettings(), store, no_wake), folder)
        store.close()
