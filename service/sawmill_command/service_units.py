"""systemd units for this installation: programs and users, and the files that the service may access.

The hardening leaves out settings that the product cannot work with: Numba makes memory executable
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

from sawmill_service.http.limits.open_files import files_needed
from sawmill_service.settings import MOST_CONNECTIONS

STATE, CACHE, SETTINGS = Path("/var/lib"), Path("/var/cache/sawmill"), Path("/etc/sawmill/sawmill.env")
DATA = STATE / "sawmill"
_MOVE = "keep installations in a folder that all may read, as /opt/sawmill, and data in one as /var/lib/sawmill"
# Folders that `PrivateTmp` and `ProtectHome` hide.
_EMPTIED = (Path("/tmp"), Path("/var/tmp"))  # noqa: S108 - compared, not written to
_HOMES = (Path("/home"), Path("/root"), Path("/run/user"))
# Time in addition to SAWMILL_STOP_GRACE_S and SAWMILL_KILL_GRACE_S, s, for answers, uploads and a slow database.
STOP_S = 30

# Characters that systemd does not accept in the path of a program.
_QUOTING = re.compile(r"[\"'\\]")

_LASTING = f"""\
KillMode=mixed
TimeoutStopSec={STOP_S}
Restart=on-failure
RestartSec=5
# A setting that is wrong stays wrong.
RestartPreventExitStatus=2
"""
_BOUNDED = f"""\
# A job's process that takes too much is ended alone, and the job is tried again or fails.
MemoryMax=80%
OOMPolicy=continue
TasksMax=2048
LimitNOFILE=1024:{files_needed(MOST_CONNECTIONS)}
LimitCORE=0
NoNewPrivileges=yes
CapabilityBoundingSet=
PrivateDevices=yes
PrivateTmp=yes
ProtectClock=yes
ProtectControlGroups=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectProc=invisible
LockPersonality=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6
RestrictNamespaces=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
SystemCallArchitectures=native
SystemCallErrorNumber=EPERM
SystemCallFilter=@system-service
SystemCallFilter=landlock_create_ruleset landlock_add_rule landlock_restrict_self seccomp
"""
# Settings of units that compute.
_CACHED = f"""\
Environment=NUMBA_CACHE_DIR={CACHE} MPLCONFIGDIR={CACHE}/matplotlib
CacheDirectory={CACHE.name}
"""
_STRICT = "ProtectSystem=strict\n"
_COMMON = _LASTING + _BOUNDED + _STRICT


@dataclass(frozen=True)
class Installation:
    """Program, data, user, file of the first key and watched folders; a `ValueError` names what would be right."""

    program: Path
    data: Path = DATA
    user: str = "sawmill"
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
        """Return the text of each unit by the name of its file."""
        return {
            "sawmill.service": self._service(),
            "sawmill-worker@.service": self._worker(),
            "sawmill-backup@.service": self._backup(),
            "sawmill-backup@.timer": _NIGHTLY,
        }

    def write(self, folder: Path) -> list[Path]:
        """Write all units or none; older units of the same names are replaced."""
        with tempfile.TemporaryDirectory(dir=folder) as fresh:
            for name, text in self.units().items():
                (Path(fresh) / name).write_text(text)
            return [(Path(fresh) / name).replace(folder / name) for name in self.units()]

    def next_steps(self, *, written: bool) -> list[str]:
        """Return the commands that root must run next, with that which writes the units if they are not written."""
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

    def _service(self) -> str:
        return f"""\
# The service with its own workers: its settings are in {SETTINGS}, changes of this file belong into
# a file beside it (systemctl edit sawmill.service).
[Unit]
Description=Sawmill calibration
{self._unit()}
[Service]
Type=notify
# Compiles what is not compiled yet, so that no job waits for it.
ExecStartPre=-{self._command("compile")}
ExecStart={self._command("serve")}
# A database that is away is awaited, and tables of an earlier version are brought up to date.
TimeoutStartSec=infinity
# The service's loop reports twice in this time.
WatchdogSec=60
{self._credential()}{self._on_data()}{self._watching()}{_CACHED}{_COMMON}
[Install]
WantedBy=multi-user.target
"""

    def _worker(self) -> str:
        return f"""\
# One more worker for each name, as sawmill-worker@1.service: on the service's machine, or, with PostgreSQL and a data
# folder that both mount, on another one. Settings and changes are as those of sawmill.service.
[Unit]
Description=Sawmill calibration, worker %i
{self._unit()}
[Service]
Type=exec
ExecStartPre=-{self._command("compile")}
ExecStart={self._command("worker")}
TimeoutStartSec=infinity
{self._on_data()}{self._watching()}{_CACHED}{_COMMON}
[Install]
WantedBy=multi-user.target
"""

    def _backup(self) -> str:
        return f"""\
# A backup into the folder of its name:
# systemd-escape --path --template=sawmill-backup@.timer /mnt/disk/backups says it.
[Unit]
Description=Backup of Sawmill calibration to %f
After=network.target
RequiresMountsFor={_word(self.program)} {_word(self.data)} %f

[Service]
Type=oneshot
ExecStart={self._command("backup")} %f --keep 30
Nice=10
# Where there is no such folder, the command says so.
ReadWritePaths=-%f
{self._on_data()}{_BOUNDED}{_STRICT}"""

    def _command(self, name: str) -> str:
        return f"{_word(self.program)} {name}"

    def _unit(self) -> str:
        return f"""\
After=network.target
RequiresMountsFor={_word(self.program)} {_word(self.data)}
StartLimitIntervalSec=600
StartLimitBurst=10
"""

    def _credential(self) -> str:
        """Return the setting that gives root's file to the service alone, in memory; workers need no token."""
        if self.token is None:
            return ""
        return f"""\
LoadCredential=sawmill_token:{_specifiers(self.token)}
Environment=SAWMILL_TOKEN_FILE=%t/credentials/%n/sawmill_token
"""

    def _watching(self) -> str:
        """Return the settings of units that take files from watched folders; a share may come after the start."""
        if not self.watched:
            return ""
        folders = json.dumps([str(folder) for folder in self.watched])
        return f"""\
Environment='SAWMILL_WATCH_FOLDERS={_specifiers(folders)}'
ReadWritePaths={" ".join(_word(f"-{folder}") for folder in self.watched)}
"""

    def _on_data(self) -> str:
        """Return the settings of units that work on the service's data, which belong only to its user."""
        in_homes = any(_below(path, _HOMES) for path in (self.program.resolve(), Path(sys.base_prefix), *self._paths))
        if STATE in self.data.parents:
            folder = f"StateDirectory={_word(self.data.relative_to(STATE))}\nStateDirectoryMode=0700"
        else:
            folder = f"ReadWritePaths={_word(self.data)}"
        return f"""\
User={self.user}
Environment=SAWMILL_LOG_FORMAT=json
ProtectHome={"read-only" if in_homes else "yes"}
Environment={_word(f"SAWMILL_DATA_FOLDER={self.data}")}
EnvironmentFile=-{SETTINGS}
{folder}
UMask=0077
"""


# The timer runs each night, or after the next start if the machine was off.
_NIGHTLY = """\
[Unit]
Description=Nightly backup of Sawmill calibration to %f

[Timer]
OnCalendar=*-*-* 02:30:00
RandomizedDelaySec=600
Persistent=yes

[Install]
WantedBy=timers.target
"""


def program() -> Path:
    """Return the path by which `sawmill` was called: a link to one of several installations stays a link."""
    called = Path(os.path.normpath(Path(sys.argv[0]).absolute()))
    return called if called.name == "sawmill" and called.is_file() else Path(sys.executable).parent / "sawmill"


def _below(path: Path, folders: tuple[Path, ...]) -> bool:
    return any(path.is_relative_to(folder) for folder in folders)


def _specifiers(value: object) -> str:
    return str(value).replace("%", "%%")


def _word(value: object) -> str:
    """Quote a value as one word for systemd.syntax(7) and systemd.unit(5)."""
    text = _specifiers(value)
    return f'"{text}"' if " " in text else text
