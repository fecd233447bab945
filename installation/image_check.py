"""Check of the container image of `make image`: it calibrates a scan where everything is taken away from it.

The image's root is read-only, its process has no capability, a user id that the image does not know, no network but
loopback, and is process 1 of its namespace. Writable are what a container may write to: /tmp and /data, empty, and
/var/cache/sawmill with the image's kernels, as a volume has them. SIGTERM ends it. Printed are the image's size and the
seconds of each step. Root runs it, on Linux.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
CACHE = Path(os.environ.get("SAWMILL_IMAGE_CACHE") or Path.home() / ".cache/sawmill-image")
API = "http://127.0.0.1:8000"
TOKEN = "a-token-of-the-image-check-alone"  # noqa: S105 - of a service that ends with the check
SCAN = "simulate l-shape --theta 146.1deg,714.7,319.9,43.7,15.7deg --views 90 --output /tmp/phantom.h5"
# Only a hang takes so long; compiling all kernels again takes two minutes.
LONGEST_S = 600.0

# For a shell in a mount namespace: $1 is the image's root, $2 an empty folder, $3 the token, $4 what makes the scan.
CONTAINED = """\
mount --rbind "$1" "$2"
mount -o remount,bind,ro "$2"
for folder in tmp data var/cache/sawmill; do mount -t tmpfs -o mode=1777 tmpfs "$2/$folder"; done
cp -a "$1/var/cache/sawmill/." "$2/var/cache/sawmill/"
mount -t tmpfs tmpfs "$2/dev"
for device in null zero random urandom; do touch "$2/dev/$device"; mount --bind "/dev/$device" "$2/dev/$device"; done
mkdir "$2/dev/shm"; mount -t tmpfs -o mode=1777 tmpfs "$2/dev/shm"
mount -t proc proc "$2/proc"
exec chroot "$2" setpriv --reuid 4242 --regid 4242 --clear-groups --bounding-set=-all --inh-caps=-all --no-new-privs \\
  env -i PATH=/opt/sawmill/bin:/usr/bin:/bin HOME=/tmp SAWMILL_DATA_FOLDER=/data NUMBA_CACHE_DIR=/var/cache/sawmill \\
  SAWMILL_TOKEN="$3" sh -euc "if touch /x 2> /dev/null; then echo the root is not read-only; exit 3; fi
sawmill $4
exec sawmill serve --no-examples --workers 1"
"""


def main() -> int:
    """Run the image and print what happened; exit code 1 where a step fails."""
    if os.environ.get("SAWMILL_IMAGE_CHECK") != "inside":
        # No network but loopback, for the client as well.
        again = ["unshare", "--net", "env", "SAWMILL_IMAGE_CHECK=inside", sys.executable, __file__]
        return subprocess.run(again, check=False).returncode  # noqa: S603 - this script
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)  # noqa: S607
    with image_root() as root, tempfile.TemporaryDirectory(prefix="image-") as scratch:
        size = sum(path.lstat().st_size for path in root.rglob("*") if path.is_file() and not path.is_symlink())
        print(f"size: {size / 1e9:.2f} GB unpacked", flush=True)
        with started(root, Path(scratch)) as service:
            with timed("ready"):
                wait_for("/health/ready", service)
            require(status_without_a_key() == 401, "a request without a key was answered")
            with timed("calibrated"):
                calibration = calibrate(Path(f"/proc/{service_process(service)}/root/tmp/phantom.h5"))
            print(f"verdict {calibration['verdict']}, theta {calibration['theta']}")
            require(calibration["verdict"] == "pass", "the calibration is not good")
            with timed("ended by SIGTERM"):
                os.kill(service_process(service), signal.SIGTERM)
                require(service.wait(LONGEST_S) == 0, "SIGTERM did not end it in order")
    return 0


@contextmanager
def image_root() -> Iterator[Path]:
    """Give the image's root folder, by the engine that built it."""
    version = output(
        sys.executable, "-c", (ROOT / "worker/sawmill_vocabulary/version.py").read_text() + "\nprint(VERSION)"
    )
    name = f"sawmill-calibration:{version}"
    if shutil.which("docker") and subprocess.run(["docker", "info"], check=False, capture_output=True).returncode == 0:  # noqa: S607
        container = output("docker", "create", name)
        with tempfile.TemporaryDirectory(prefix="image-root-") as folder:
            with subprocess.Popen(["docker", "export", container], stdout=subprocess.PIPE) as exported:  # noqa: S603, S607
                subprocess.run(["tar", "-x", "-C", folder], stdin=exported.stdout, check=True)  # noqa: S603, S607
            output("docker", "rm", container)
            yield Path(folder)
        return
    builder = ["buildah", "--root", CACHE / "layers", "--runroot", CACHE / "run", "--storage-driver", "overlay"]
    container = output(*builder, "from", "--pull-never", f"localhost/{name}")
    try:
        yield Path(output(*builder, "mount", container))
    finally:
        output(*builder, "rm", container)


@contextmanager
def started(root: Path, scratch: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """Run the service as process 1 of a namespace; kill what is left of it, and show its log where the check failed."""
    here, log = scratch / "root", scratch / "service.log"
    here.mkdir()
    contained = ["sh", "-euc", CONTAINED, "sh", str(root), str(here), TOKEN, SCAN]
    command = ["unshare", "--mount", "--pid", "--fork", "--kill-child", *contained]
    with log.open("wb") as file, subprocess.Popen(command, stdout=file, stderr=file) as service:  # noqa: S603 - our own
        try:
            yield service
        except BaseException:
            print(log.read_text(), file=sys.stderr)
            raise
        finally:
            service.kill()


def service_process(service: "subprocess.Popen[bytes]") -> int:
    """Return the id, outside, of the namespace's process 1."""
    return int(Path(f"/proc/{service.pid}/task/{service.pid}/children").read_text().split()[0])


def wait_for(path: str, service: "subprocess.Popen[bytes]") -> None:
    """Wait until the service answers."""
    deadline = time.monotonic() + LONGEST_S
    while time.monotonic() < deadline:
        require(service.poll() is None, "the service ended while it started")
        try:
            ask("GET", path)
        except OSError:
            time.sleep(0.2)
        else:
            return
    sys.exit(f"the service was not ready within {LONGEST_S:g} s")


def status_without_a_key() -> int:
    """Return the status of a request that brings no key."""
    try:
        with urllib.request.urlopen(f"{API}/v1/scanners") as answer:  # noqa: S310 - our own address
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


def calibrate(scan: Path) -> dict[str, Any]:
    """Send a scan and return its calibration when it is finished."""
    scanner = ask("POST", "/v1/scanners", (ROOT / "examples/scanner.json").read_bytes())["id"]
    sent = ask("POST", f"/v1/scans?scanner_id={scanner}&data=counts&phantom_id=l-shape", scan.read_bytes())
    asked = ask("POST", "/v1/calibrations", json.dumps({"scan_id": sent["id"]}).encode())
    while True:
        calibration = ask("GET", f"/v1/calibrations/{asked['id']}?wait=20")
        if calibration["state"] not in {"queued", "running"}:
            return calibration


def ask(method: str, path: str, body: bytes | None = None) -> dict[str, Any]:
    """Send a request with the key; an error of the service is printed."""
    kind = "application/octet-stream" if path.startswith("/v1/scans") else "application/json"
    headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": kind}
    request = urllib.request.Request(f"{API}{path}", body, headers, method=method)  # noqa: S310 - our own address
    try:
        with urllib.request.urlopen(request, timeout=LONGEST_S) as answer:  # noqa: S310
            answered: dict[str, Any] = json.load(answer)
            return answered
    except urllib.error.HTTPError as error:
        print(error.read().decode(), file=sys.stderr)
        raise


def output(*command: str | Path) -> str:
    """Return the standard output of a command."""
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()  # noqa: S603


@contextmanager
def timed(what: str) -> Iterator[None]:
    """Print how long the block took."""
    start = time.monotonic()
    yield
    print(f"{what}: {time.monotonic() - start:.1f} s", flush=True)


def require(right: object, sentence: str) -> None:
    """End the check with a sentence where something is wrong."""
    if not right:
        sys.exit(sentence)


if __name__ == "__main__":
    sys.exit(main())
