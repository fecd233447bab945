"""Call and output of `sawmill doctor`."""

import platform
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sawmill_command.data_option import settings_of
from sawmill_command.doctor import machine, store
from sawmill_command.doctor.machine import DoctorFinding, State, bad, good
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.settings import ExecutionSettings, WrongVariableError, variables_checked
from sawmill_platform.workers.sole_service import serving_process
from sawmill_service.settings import ServiceSettings
from sawmill_vocabulary.version import VERSION

_COLOURS = {State.GOOD: "green", State.WATCH: "yellow", State.BAD: "red"}


def examine(data: Path | None) -> list[DoctorFinding]:
    """Check everything from the settings to Redis; nothing is changed and no store is made."""
    try:
        with variables_checked():
            settings, execution = ServiceSettings(), ExecutionSettings()
            storage = settings_of(data)
    except WrongVariableError as error:
        return [bad("settings", str(error), "then ask the doctor again")]
    return list(_examine(settings, storage, execution))


def _examine(
    settings: ServiceSettings, storage: StorageSettings, execution: ExecutionSettings
) -> Iterator[DoctorFinding]:
    yield good("settings", "every SAWMILL_ variable is a setting and holds what it can")
    yield good("versions", f"sawmill-calibration {VERSION}, Python {platform.python_version()}")
    yield machine.kernels()
    yield machine.memory()
    yield from machine.limits_of_system(settings, execution)
    yield from machine.data_folder(storage)
    yield from machine.watched_folders(storage.watch_folders)
    yield store.broker(execution.broker_url)
    if machine.is_closed(storage.data_folder):
        return
    yield from _service(settings, storage)
    if storage.is_made:
        yield store.backup(storage.data_folder)
    if storage.is_made or not storage.is_one_file:
        yield from store.database(storage, settings)
    else:
        yield from store.files_without_database(storage.data_folder)


def _service(settings: ServiceSettings, storage: StorageSettings) -> Iterator[DoctorFinding]:
    try:
        process = serving_process(storage)
    except OSError as error:
        yield bad("service", str(error), machine.run_as_owner(storage.data_folder))
        return
    if process is not None:
        yield good("service", f"process {process} serves the data folder")
    else:
        yield machine.address(settings, may_be_ours=not storage.is_one_file)


def show(findings: Sequence[DoctorFinding]) -> None:
    """Print a row per finding, and the cure below a bad finding."""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    for finding in findings:
        table.add_row(f"[{_COLOURS[finding.state]}]{finding.state}[/]", finding.subject, escape(finding.sentence))
        if finding.cure:
            table.add_row("", "", f"[bold]{escape(finding.cure)}[/]")
    Console().print(table)
