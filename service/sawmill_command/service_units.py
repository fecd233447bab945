"""systemd units for this installation: the templates in `units` with its program, user and folders.

The hardening of the templates leaves out settings that the product cannot work with: Numba makes memory executable
(`MemoryDenyWriteExecute`), an attempt reads the machine's memory and cores (`ProcSubset`), and confines itself to its
own files by system calls that are in none of systemd's sets (`landlock_...`, `seccomp`).
"""

import json
import os
import re
import shlex
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from string import Template

STATE = Path("/var/lib")
DATA = STATE / "sawmill"
_MOVE = "keep installations in a folder that all may read, as /opt/sawmill, and data in one as /var/lib/sawmill"
# Folders that `PrivateTmp` and `ProtectHome` hide.
_EMPTIED = (Path("/tmp"), Path("/var/tmp"))  # noqa: S108 - compared, not written to
_HOMES = (Path("/home"), Path("/root"), Path("/run/user"))
# Characters that systemd does not accept in the path of a program.
_QUOTING = re.compile(r"[\"'\\]")

_CREDENTIAL = """\
LoadCredential=sawmill_token:{}
Environment=SAWMILL_TOKEN_FILE=%t/credentials/%n/sawmill_token
"""
_TEMPLATES = Path(__file__).parent / "units"


@dataclass(frozen=True)
class Installation:
    """Program, data, user, file of the first key and watched folders; a `ValueError` names what would be right."""

    program: Path
    data: Path = DATA
    user: str = "sawmill"
    # A file with the first administrator's key, which only root needs to be able to read.
    token: Path | None = None
    watched: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z_][a-z0-9_-]{0,31}", self.user):
            msg = f"a user's name has lower-case letters, digits, - and _ alone, as sawmill, not {self.user!r}"
            raise ValueError(msg)
        for path in self._paths:
            if not path.is_absolute() or not str(path).isprintable() or _QUOTING.search(str(path)):
                msg = f"{str(path)!r} must be an absolute path of printable characters but quotes and \\, as {DATA}"
                raise ValueError(msg)

    @property
    def _paths(self) -> list[Path]:
        return [self.program, self.data, *([] if self.token is None else [self.token]), *self.watched]

    def doubts(self) -> Iterator[str]:
        """Yield reasons why the service might not start, which depend on rights of the user that are not known here."""
        ways = [self.program, self.program.resolve(), Path(sys.base_prefix, "bin")]
        folders = [folder for way in ways for folder in reversed(way.parents)]
        closed = next((folder for folder in folders if folder.is_dir() and not folder.stat().st_mode & 1), None)
        if closed is not None:
            yield f"{closed} is closed to other users, and the program or its Python is in there: {_MOVE}"
        for path in (*ways, *self._paths):
            if _below(path, _EMPTIED):
                yield f"{path} is in a folder that the system empties, and that each unit has of its own: {_MOVE}"
                return

    def units(self) -> dict[str, str]:
        """Return the text of each unit by the file's name."""
        in_homes = any(_below(path, _HOMES) for path in (self.program.resolve(), Path(sys.base_prefix), *self._paths))
        if STATE in self.data.parents:
            folder = f"StateDirectory={_word(self.data.relative_to(STATE))}\nStateDirectoryMode=0700"
        else:
            folder = f"ReadWritePaths={_word(self.data)}"
        values = {
            "program": _word(self.program),
            "data": _word(self.data),
            "setting": _word(f"SAWMILL_DATA_FOLDER={self.data}"),
            "user": self.user,
            "homes": "read-only" if in_homes else "yes",
            "folder": folder,
            "folders": folder + self._watching(),
            # Root's file is given to the service alone, in memory; workers need no token.
            "credential": "" if self.token is None else _CREDENTIAL.format(_specifiers(self.token)),
        }
        parts = {path.stem: _filled(path, values).rstrip() for path in _TEMPLATES.glob("*.part")}
        return {path.name: _filled(path, values | parts) for path in sorted(_TEMPLATES.glob("sawmill*"))}

    def write(self, folder: Path) -> list[Path]:
        """Write all units or none; older units of the same names are replaced."""
        with tempfile.TemporaryDirectory(dir=folder) as fresh:
            for name, text in self.units().items():
                (Path(fresh) / name).write_text(text)
            return [(Path(fresh) / name).replace(folder / name) for name in self.units()]

    def next_steps(self, *, written: bool) -> list[str]:
        """Return the commands that root must run next; `written` if systemd reads the folder of the units."""
        steps = [f"useradd --system --user-group --home-dir {DATA} --shell /usr/sbin/nologin {self.user}"]
        if STATE not in self.data.parents:
            steps.append(shlex.join(["install", "--directory", f"--owner={self.user}", "--mode=700", str(self.data)]))
        if not written:
            command = [str(self.program), "install-service", "--to", "/etc/systemd/system", *self._flags()]
            steps.append(shlex.join(command))
        return [*steps, "systemctl daemon-reload", "systemctl enable --now sawmill.service"]

    def _flags(self) -> Iterator[str]:
        if self.data != DATA:
            yield f"--data={self.data}"
        if self.user != "sawmill":
            yield f"--user={self.user}"
        if self.token is not None:
            yield f"--token={self.token}"
        yield from (f"--watch={folder}" for folder in self.watched)

    def _watching(self) -> str:
        """Return the settings of units that take files from watched folders; a share may come after the start."""
        if not self.watched:
            return ""
        folders = _specifiers(json.dumps([str(folder) for folder in self.watched]))
        paths = " ".join(_word(f"-{folder}") for folder in self.watched)
        return f"\nEnvironment='SAWMILL_WATCH_FOLDERS={folders}'\nReadWritePaths={paths}"


def program() -> Path:
    """Return the path by which `sawmill` was called: a link to one of several installations stays a link."""
    called = Path(os.path.normpath(Path(sys.argv[0]).absolute()))
    return called if called.name == "sawmill" and called.is_file() else Path(sys.executable).parent / "sawmill"


def _filled(template: Path, values: dict[str, str]) -> str:
    return Template(template.read_text()).substitute(values)


def _below(path: Path, folders: tuple[Path, ...]) -> bool:
    return any(path.is_relative_to(folder) for folder in folders)


def _specifiers(value: object) -> str:
    return str(value).replace("%", "%%")


def _word(value: object) -> str:
    """Quote a value as one word for systemd.syntax(7) and systemd.unit(5)."""
    text = _specifiers(value)
    return f'"{text}"' if " " in text else text
