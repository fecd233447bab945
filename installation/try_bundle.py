"""The bundle of `make bundle` in an empty environment, in a namespace of the kernel's that has no network.

Every command begins with an empty environment and a fresh home: `install.sh`, `sawmill doctor`, `sawmill serve` with
the whole job of the Python client, a second installation of the same version, which is refused, and an upgrade and the
way back from it. Exit code 1 where anything fails. Printed are seconds and sizes.
"""

import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bundle import ROOT, build, digest

VERSION_FILE = "worker/sawmill_vocabulary/version.py"
LATER = "99.0.0"
# Loopback is down too without a network: this sets the flags of <net/if.h> by ioctl(SIOCSIFFLAGS).
LOOPBACK_UP = """\
import fcntl, socket, struct
with socket.socket() as any_socket:
    fcntl.ioctl(any_socket, 0x8914, struct.pack("16sH14x", b"lo", 0x41))
"""
UNREACHABLE = """\
import socket
try:
    socket.create_connection(("192.0.2.1", 80), 5)
except OSError as error:
    print(error)
else:
    raise SystemExit("there is a network")
"""
SERVE_AND_CALIBRATE = """\
python -c {loopback}
python -c {unreachable}
sawmill serve --no-examples 2> service.log &
service=$!
trap 'kill $service 2> /dev/null' EXIT
for _ in $(seq 120); do curl -sf -o /dev/null http://127.0.0.1:8000/health/ready && break; sleep 0.5; done
{simulate}
python {documents}/examples/clients/whole_job.py http://127.0.0.1:8000 mill.h5
sawmill doctor
trap - EXIT
kill $service
wait $service
"""


def main() -> int:
    """Run every part of the trial in turn."""
    (archive,) = (ROOT / "dist").glob("*.tar.gz")
    print(f"{archive.name}: {archive.stat().st_size / 1e6:.0f} MB", flush=True)
    with tempfile.TemporaryDirectory(prefix="bundle-") as temporary:
        # A name with a space, as people have them.
        base = Path(temporary, "the mill")
        base.mkdir()
        with timed("packed again, the same bytes"):
            again = build(ROOT, base / "again", ROOT / "build/wheels")
            require(digest(again) == digest(archive), f"{again.name} differs from the first one")
        bundle = unpacked(archive, base)
        target = base / "sawmill"
        with timed("install.sh"):
            shown = without_network(base, installing(bundle, target))
        require("install-service" in shown, "the next step is not named")
        installed = sum(path.lstat().st_size for path in target.rglob("*") if path.is_file())
        print(f"installed: {installed / 1e6:.0f} MB", flush=True)
        documents = target / "current/share/sawmill"
        with timed("served, the whole job of the Python client"):
            shown = without_network(base, served(documents), target / "current/bin")
        require("calibration: pass" in shown, f"no calibration passed:\n{shown}")
        require("not compiled yet" not in shown, f"kernels are missing:\n{shown}")
        refused = without_network(base, f"! {installing(bundle, target)} 2>&1")
        require("is installed; remove that folder" in refused, f"installed over itself:\n{refused}")
        with timed("packed a later version"):
            later = later_bundle(base)
        with timed("installed it beside"):
            shown = without_network(base, installing(unpacked(later, base), target))
        first = version(base, target)
        (change,) = re.findall(r"^  (ln .*)$", shown, re.MULTILINE)
        without_network(base, change)
        second = version(base, target)
        without_network(base, change.replace(LATER, first))
        require((second, version(base, target)) == (LATER, first), "the upgrade or the way back failed")
        print(f"upgraded from {first} to {second} and back")
    return 0


def installing(bundle: Path, target: Path) -> str:
    """Return the command that installs an unpacked bundle."""
    return f"sh {quoted(bundle / 'install.sh')} --python {quoted(sys.executable)} {quoted(target)}"


def served(documents: Path) -> str:
    """Return a script that runs an installed example, with the scan of its page, and a service in the background."""
    page = (documents / "docs/start/first-program.md").read_text()
    (simulate,) = re.findall(r"^sawmill simulate .+$", page, re.MULTILINE)
    parts = {"loopback": LOOPBACK_UP, "unreachable": UNREACHABLE, "documents": str(documents)}
    return SERVE_AND_CALIBRATE.format(simulate=simulate, **{name: shlex.quote(part) for name, part in parts.items()})


def later_bundle(base: Path) -> Path:
    """Build a bundle of the same commit under another version."""
    clone = base / "later"
    run(["git", "clone", "--quiet", str(ROOT), str(clone)], base)
    (clone / VERSION_FILE).write_text(re.sub(r'"[\d.]+"', f'"{LATER}"', (clone / VERSION_FILE).read_text()))
    author = ["-c", "user.name=nobody", "-c", "user.email=nobody@mill.example"]
    run(["git", *author, "commit", "--quiet", "--all", "--message", "A later version"], clone)
    return build(clone, base / "dist", ROOT / "build/wheels")


def version(base: Path, target: Path) -> str:
    """Return the version to which the link leads."""
    return without_network(base, "sawmill --version", target / "current/bin").strip()


def unpacked(archive: Path, base: Path) -> Path:
    """Unpack an archive with tar(1) after its checksum has been checked; return its folder."""
    run(["sha256sum", "--check", "--quiet", f"{archive.name}.sha256"], archive.parent)
    run(["tar", "-xzf", str(archive)], base)
    return base / archive.name.removesuffix(".tar.gz")


def without_network(base: Path, script: str, programs: Path | None = None) -> str:
    """Run a script with an empty home and environment, without network; return its output."""
    folder = Path(tempfile.mkdtemp(dir=base))
    path = "/usr/bin:/bin" if programs is None else f"{programs}:/usr/bin:/bin"
    alone = ["unshare", "--map-root-user", "--net", "env", "-i", f"HOME={folder}", f"PATH={path}"]
    return run([*alone, "sh", "-euc", script], folder)


def run(command: list[str], folder: Path) -> str:
    """Run one command and return its standard output; its failure ends the study."""
    done = subprocess.run(command, cwd=folder, check=False, stdout=subprocess.PIPE, text=True)  # noqa: S603 - our own
    require(done.returncode == 0, f"{shlex.join(command)}\n{done.stdout}\nended with exit code {done.returncode}")
    return done.stdout


@contextmanager
def timed(what: str) -> Iterator[None]:
    """Print how long the block took."""
    began = time.monotonic()
    yield
    print(f"{what}: {time.monotonic() - began:.0f} s", flush=True)


def require(true: bool, otherwise: str) -> None:  # noqa: FBT001 - reads as a sentence
    """End the study where a condition does not hold."""
    if not true:
        sys.exit(otherwise)


def quoted(path: Path | str) -> str:
    """Quote a path for a shell."""
    return shlex.quote(str(path))


if __name__ == "__main__":
    sys.exit(main())
