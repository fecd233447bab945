"""The systemd units: systemd can read them, and what they start does what they say of it."""

import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from asgi import absent
from missing_parts import free_port, skip_without
from plain_logs import log_plainly
from structlog.testing import capture_logs
from typer.testing import CliRunner, Result

from sawmill_command.commands import main
from sawmill_command.service_units import Installation, program
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_service.http.listening import files_needed
from sawmill_service.settings import MOST_CONNECTIONS, ServiceSettings
from sawmill_service.stopping import SHUTDOWN_S, ServiceManager

# Those that the units use, by section, after systemd.unit(5), systemd.service(5), systemd.exec(5), systemd.kill(5) and
# systemd.resource-control(5).
KNOWN = {
    "Timer": "OnCalendar Persistent RandomizedDelaySec",
    "Unit": "After Description RequiresMountsFor StartLimitBurst StartLimitIntervalSec",
    "Service": """
        CacheDirectory CapabilityBoundingSet Environment EnvironmentFile ExecStart ExecStartPre KillMode LimitCORE
        LimitNOFILE LoadCredential LockPersonality MemoryMax Nice NoNewPrivileges OOMPolicy PrivateDevices PrivateTmp
        ProtectClock ProtectControlGroups ProtectHome ProtectHostname ProtectKernelLogs ProtectKernelModules
        ProtectKernelTunables ProtectProc ProtectSystem ReadWritePaths Restart RestartPreventExitStatus RestartSec
        RestrictAddressFamilies RestrictNamespaces RestrictRealtime RestrictSUIDSGID StateDirectory StateDirectoryMode
        SystemCallArchitectures SystemCallErrorNumber SystemCallFilter TasksMax TimeoutStartSec TimeoutStopSec Type
        UMask User WatchdogSec""",
    "Install": "WantedBy",
}
LISTS = {"Environment", "SystemCallFilter"}
TOKEN = "-".join(["four"] * 8)

Unit = dict[str, dict[str, list[str]]]


def parsed(text: str) -> Unit:
    """The sections of a unit; a line that systemd would pass over with a warning fails."""
    unit: Unit = {}
    for line in filter(None, text.splitlines()):
        if line.startswith("["):
            section = unit.setdefault(line.strip("[]"), {})
        elif not line.startswith("#"):
            name, equals, value = line.partition("=")
            assert equals, line
            section.setdefault(name, []).append(value)
    for name, directives in unit.items():
        assert directives.keys() <= set(KNOWN[name].split()), name
        assert all(len(values) == 1 or directive in LISTS for directive, values in directives.items()), name
    return unit


def install(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(main, ["install-service", *map(str, arguments)], terminal_width=200)
    assert result.exit_code == code, result.output
    return result


@pytest.mark.parametrize("name", ["sawmill.service", "sawmill-worker@.service"])
def test_a_unit_starts_a_command_as_its_own_user_within_limits_that_leave_attempts_room(name):
    service = parsed(Installation(program()).units()[name])["Service"]
    for start in (*service["ExecStart"], service["ExecStartPre"][0].removeprefix("-")):
        command, subcommand = shlex.split(start)
        assert os.access(command, os.X_OK)
        assert subcommand in {"serve", "worker", "compile"}
    assert (service["User"], service["StateDirectory"]) == (["sawmill"], ["sawmill"])
    settings = ExecutionSettings()
    graces = settings.stop_grace_s + settings.kill_grace_s
    assert float(service["TimeoutStopSec"][0]) > SHUTDOWN_S + graces + 12
    _, hard = service["LimitNOFILE"][0].split(":")
    assert int(hard) == files_needed(MOST_CONNECTIONS)
    (bounds,) = (each for each in ServiceSettings.model_fields["max_connections"].metadata if hasattr(each, "le"))
    assert bounds.le == MOST_CONNECTIONS
    allowed = " ".join(service["SystemCallFilter"]).split()
    # In no set of systemd's: without them attempts would run with all rights of the service.
    assert {"landlock_create_ruleset", "landlock_add_rule", "landlock_restrict_self", "seccomp"} < set(allowed)
    # Numba makes memory executable; memory and cores are read from /proc.
    assert not service.keys() & {"MemoryDenyWriteExecute", "ProcSubset"}
    # A job's process that is ended for its memory takes no other with it.
    assert (service["OOMPolicy"], service["KillMode"]) == (["continue"], ["mixed"])


def test_watched_folders_are_the_service_s_and_its_workers_and_a_backup_is_named_by_its_instance():
    folders = (Path("/srv/scanner data"), Path("/mnt/50%"))
    units = {name: parsed(text) for name, text in Installation(program(), watched=folders).units().items()}
    for name in ("sawmill.service", "sawmill-worker@.service"):
        service = units[name]["Service"]
        # A share that is away at the start may come at any time.
        assert service["ReadWritePaths"] == ['"-/srv/scanner data" -/mnt/50%%']
        [setting] = [shlex.split(text)[0] for text in service["Environment"] if "WATCH" in text]
        assert json.loads(setting.replace("%%", "%").partition("=")[2]) == list(map(str, folders))
    assert "WATCH" not in str(units["sawmill-backup@.service"])
    answer = install("--print", "--watch", "/srv/a", "--watch", "/srv/b")
    assert absent(answer.output, "ReadWritePaths=-/srv/a -/srv/b\n", "--watch=/srv/a --watch=/srv/b") == []
    assert "'scanners' must be an" in install("--print", "--watch", "scanners", code=2).output
    units = {name: parsed(text) for name, text in Installation(program()).units().items()}
    backup = units["sawmill-backup@.service"]["Service"]
    assert shlex.split(backup["ExecStart"][0])[1:] == ["backup", "%f", "--keep", "30"]
    # A folder that is not there is named by the command, and not by systemd's status 226.
    assert (backup["ReadWritePaths"], backup["ProtectSystem"], backup["Type"]) == (["-%f"], ["strict"], ["oneshot"])
    assert (backup["StateDirectory"], backup["UMask"]) == (["sawmill"], ["0077"])
    answer = CliRunner().invoke(main, ["backup", "--help"])
    assert (answer.exit_code, "--keep" in answer.output) == (0, True)
    assert units["sawmill-backup@.timer"]["Timer"]["Persistent"] == ["yes"]


def test_systemd_reads_the_units_whatever_is_in_their_paths(tmp_path):
    if shutil.which("systemd-analyze") is None:
        skip_without("there is no systemd-analyze here")
    in_order = Installation(program()).write(tmp_path)
    odd = Installation(Path("/opt/50 % of $x/sawmill"), Path("/srv/data %i"), "mill", Path("/etc/my %t/token"))
    (elsewhere := tmp_path / "odd").mkdir()
    for units, complaint in ((in_order, ""), (odd.write(elsewhere), f"Command {odd.program} is not executable")):
        command = ["systemd-analyze", "verify", "--man=no", *map(str, units)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        # It looks for the program by the path as systemd understands it.
        assert [line for line in done.stderr.splitlines() if not complaint or complaint not in line] == []
        assert bool(done.returncode) is bool(complaint)


def test_units_are_printed_or_written_with_what_follows_and_doubted_where_they_could_not_start(tmp_path):
    printed = install("--print")
    assert "install-service --to /etc/systemd/system" in printed.stderr
    assert "systemctl enable --now sawmill.service" in printed.stderr
    (tmp_path / "sawmill.service").write_text("an older one")
    assert "install-service" not in install("--to", tmp_path).stderr
    units = Installation(program()).units()
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == units
    assert printed.stdout == "".join(f"# {name}\n{text}\n" for name, text in units.items())
    assert "The units cannot be written" in install("--to", "/proc", code=1).stderr
    service = parsed(Installation(program(), Path("/srv/my data")).units()["sawmill.service"])
    assert service["Service"]["ReadWritePaths"] == ['"/srv/my data"']
    assert service["Unit"]["RequiresMountsFor"][0].endswith('"/srv/my data"')
    assert "StateDirectory" not in service["Service"]
    steps = install("--to", tmp_path, "--data", "/srv/my data").stderr
    assert "install --directory --owner=sawmill --mode=700 '/srv/my data'" in steps
    (closed := tmp_path / "closed").mkdir(mode=0o700)
    (doubt, *_) = Installation(closed / "bin/sawmill").doubts()
    assert "is closed to other users" in doubt
    # PrivateTmp hides it.
    shown = install("--print", "--data", "/var/tmp/data").stderr  # noqa: S108 - nothing is written there
    assert "is in a folder that the system empties" in shown


def test_what_could_not_work_is_refused():
    for arguments, sentence in (
        ((), "'--print' or '--to'"),
        (("--print", "--to", "."), "one of them, not both"),
        (("--print", "--user", "Mr. Mill"), "not 'Mr. Mill'"),
        (("--print", "--data", '/srv/"data"'), "must be an absolute path of printable characters"),
        (("--print", "--token", "/etc/to\nken"), "must be an absolute path of printable characters"),
    ):
        complaint = install(*arguments, code=2)
        assert complaint.stdout == ""
        assert sentence in " ".join(complaint.stderr.replace("│", " ").split())


def test_a_command_that_is_a_link_stays_one(tmp_path):
    (tmp_path / "0.2.0").mkdir()
    command = tmp_path / "0.2.0/sawmill"
    command.write_text(f"#!{sys.executable}\nfrom sawmill_command.commands import main\nmain()\n")
    command.chmod(0o755)
    (tmp_path / "current").symlink_to("0.2.0")
    called = [tmp_path / "current/sawmill", "install-service", "--print"]
    printed = subprocess.run(called, capture_output=True, text=True, check=True).stdout
    assert f"ExecStart={tmp_path}/current/sawmill serve" in printed
    assert program() == Path(sys.executable).parent / "sawmill", "a test is no command"


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.settimeout(60)
        yield listening


def test_signs_of_life_come_at_half_the_interval_and_a_manager_that_is_gone_is_logged(manager, tmp_path):
    address, now_s = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "100000"}, [1000.0]
    alive = ServiceManager(address, clock_s=lambda: now_s[-1])
    manager.settimeout(0)
    for at_s, shown in ((1000.0, True), (1000.04, False), (1000.06, True), (1000.1, False), (1000.2, True)):
        now_s.append(at_s)
        alive.show_life()
        if shown:
            assert manager.recv(100) == b"WATCHDOG=1"
        else:
            with pytest.raises(BlockingIOError):
                manager.recv(100)
    for others in ({}, {**address, "WATCHDOG_PID": "1"}, {**address, "WATCHDOG_USEC": "0"}):
        ServiceManager(others).show_life()
    with pytest.raises(BlockingIOError):
        manager.recv(100)
    name = f"sawmill-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(f"\0{name}")
        ServiceManager({"NOTIFY_SOCKET": f"@{name}"}).report("READY=1")
        assert listening.recv(100) == b"READY=1"
    with capture_logs() as logs:
        ServiceManager({"NOTIFY_SOCKET": f"@{name}"}).report("READY=1")
    log_plainly()
    assert [(line["event"], line["state"]) for line in logs] == [("state-not-reported", "READY=1")]


def given_environment(service: dict[str, list[str]], runtime: Path, settings: dict[str, str]) -> dict[str, str]:
    """What systemd gives the process: its own few variables, the unit's, and those of the settings' file."""
    words = [word for line in service["Environment"] for word in shlex.split(line)]
    given = dict(word.replace("%t", str(runtime)).replace("%n", "sawmill.service").split("=", 1) for word in words)
    # Where the tests' interpreter finds the tree that is tested.
    path = {name: os.environ[name] for name in ("PYTHONPATH",) if name in os.environ}
    return path | {"PATH": "/usr/local/bin:/usr/bin:/bin", "HOME": str(runtime), "USER": "sawmill"} | given | settings


@pytest.mark.slow
def test_the_unit_s_command_with_its_environment_reports_lives_and_stops(manager, tmp_path):
    service = parsed(Installation(program(), token=Path("/etc/sawmill/token")).units()["sawmill.service"])["Service"]
    credential = tmp_path / "credentials/sawmill.service/sawmill_token"
    credential.parent.mkdir(parents=True)
    credential.write_text(TOKEN)
    port = free_port()
    changes = {"SAWMILL_DATA_FOLDER": str(tmp_path / "data"), "SAWMILL_PORT": str(port), "NUMBA_CACHE_DIR": ""}
    reported = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "200000"}
    environment = given_environment(service, tmp_path, changes) | reported
    with (
        (tmp_path / "log").open("w") as log,
        subprocess.Popen(shlex.split(service["ExecStart"][0]), env=environment, stderr=log) as process,
    ):
        try:
            assert manager.recv(100) == b"READY=1", (tmp_path / "log").read_text()
            address = f"http://127.0.0.1:{port}"
            assert httpx.get(f"{address}/health/ready", trust_env=False, timeout=60).json()["state"] == "ready"
            assert httpx.get(f"{address}/v1/scanners", trust_env=False, timeout=60).status_code == 401
            headers = {"Authorization": f"Bearer {TOKEN}"}
            assert httpx.get(f"{address}/v1/scanners", headers=headers, trust_env=False, timeout=60).status_code == 200
            assert manager.recv(100) == b"WATCHDOG=1"
            process.send_signal(signal.SIGTERM)
            assert set(iter(lambda: manager.recv(100), b"STOPPING=1")) <= {b"WATCHDOG=1"}
            assert process.wait(60) == 0
        finally:
            process.kill()
    lines = (tmp_path / "log").read_text().splitlines()
    assert all(re.fullmatch(r"\{.*\}", line) for line in lines), lines
