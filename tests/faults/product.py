"""The product as a mill runs it: `sawmill serve` and, with a broker, a Celery worker; started again when they end."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import httpx
from tests.faults.processes import MARK, marked, send
from tests.support.missing_parts import free_port

READY_S = 120.0
LONGEST_STOP_S = 40.0
LEASE_S = 4.0
# Waits in proportion to a lease of four seconds instead of a minute; a thread for each worker's job.
SETTINGS = {
    "SAWMILL_LEASE_S": f"{LEASE_S:g}",
    "SAWMILL_HEARTBEAT_S": "1",
    "SAWMILL_HOUSEKEEPING_S": "0.5",
    "SAWMILL_LOSS_WAIT_S": "0.2",
    "SAWMILL_OUTAGE_WAIT_S": "0.5",
    "SAWMILL_SWEEP_S": "2",
    "SAWMILL_LEFTOVERS_S": "5",
    "SAWMILL_STALL_S": "12",
    "SAWMILL_MAX_ATTEMPTS": "10",  # the faults choose their victims blindly: a job may be hit often
    "SAWMILL_SPARE_PROCESSES": "1",
    "SAWMILL_NUMBA_NUM_THREADS": "1",
    "SAWMILL_DISK_RESERVE_BYTES": "1000000",
    "SAWMILL_LOG_FORMAT": "json",
}


class Product:
    """A server, and a Celery worker if there is a broker, kept up as an init system does; a folder has data and log."""

    def __init__(self, folder: Path, variables: Mapping[str, str], *, broker: bool) -> None:
        self.world, self._log = folder.name, folder / "log"
        self.data = folder / "data"
        kept = {name: value for name, value in os.environ.items() if not name.startswith("SAWMILL_")}
        data = {"SAWMILL_DATA_FOLDER": str(self.data)}
        self._environment = {**kept, **SETTINGS, **data, **variables, MARK: self.world}
        port = str(free_port())
        self._commands = [[sys.executable, "-m", "sawmill_command.commands", "serve", "--no-examples", "--port", port]]
        if broker:
            self._commands.append([sys.executable, "-m", "celery", "-A", "sawmill_worker.celery_app", "worker"])
        self._running: dict[int, subprocess.Popen[bytes]] = {}
        self._keeping, self._ended = threading.Lock(), threading.Event()
        self._keeper = threading.Thread(target=self._keep_up, daemon=True)
        self.client = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=30.0, trust_env=False)

    @property
    def api(self) -> list[int]:
        return [self._running[place].pid for place in sorted(self._running)]

    def start(self) -> None:
        self._start_missing()
        self.wait_until_ready()
        if not self._keeper.is_alive():
            self._keeper.start()

    def wait_until_ready(self) -> None:
        deadline = time.monotonic() + READY_S
        while time.monotonic() < deadline:
            with suppress(httpx.TransportError):
                if self.client.get("/health/ready").is_success:
                    return
            time.sleep(0.1)
        raise AssertionError(f"the service was not ready after {READY_S:g} s; see {self._log}")

    def end(self) -> float:
        """Stop everything for good; the seconds that it took."""
        self._ended.set()
        with self._keeping:
            taken_s = self._stop()
        self.client.close()
        return taken_s

    def _stop(self) -> float:
        started = time.monotonic()
        send(self.api, signal.SIGTERM)
        while marked(self.world) and time.monotonic() - started < LONGEST_STOP_S:
            time.sleep(0.05)
        taken_s = time.monotonic() - started
        send(marked(self.world), signal.SIGKILL)
        for process in self._running.values():
            process.wait()
        self._running.clear()
        return taken_s

    def _keep_up(self) -> None:
        while not self._ended.wait(0.3):
            with self._keeping:
                if not self._ended.is_set():
                    self._start_missing()

    def _start_missing(self) -> None:
        for place, command in enumerate(self._commands):
            process = self._running.get(place)
            if process is None or process.poll() is not None:
                with self._log.open("ab") as log:
                    self._running[place] = subprocess.Popen(
                        command, stdout=log, stderr=log, env=self._environment, start_new_session=True
                    )
