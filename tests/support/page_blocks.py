"""Fenced blocks of the pages, and what a line of `sawmill` may name: commands, options and settings."""

import re
from pathlib import Path

import typer
from pydantic_settings import BaseSettings
from typer.testing import CliRunner

from sawmill_command.commands import main
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_service.settings import ServiceSettings

SETTINGS: tuple[type[BaseSettings], ...] = (StorageSettings, ServiceSettings, ExecutionSettings)
KNOWN = {f"SAWMILL_{name.upper()}" for settings in SETTINGS for name in settings.model_fields}


def blocks(page: Path, language: str = "text") -> list[str]:
    found = re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)
    return [block.replace("\\\n", "") for block in found]


def in_process(*arguments: object) -> str:
    """What a command of `sawmill` that succeeds writes to standard output."""
    done = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert done.exit_code == 0, done.output
    return done.stdout


def check_options(words: list[str]) -> None:
    """Fail where the words behind `sawmill` name no command, or an option that it lacks."""
    command, rest = typer.main.get_command(main), list(words)
    while rest and rest[0] in getattr(command, "commands", {}):
        command = command.commands[rest.pop(0)]
    assert not hasattr(command, "commands"), f"there is no command sawmill {' '.join(words)}"
    flags = {flag for parameter in command.params for flag in parameter.opts}
    assert {word for word in rest if word.startswith("--")} <= flags, words
