"""Write installation/hashes.txt: packages that bundle and image install, with the SHA-256 of their wheels.

    python installation/wheel_hashes.py

pip names the wheel of each Python and processor; most registries state the digest, so that little is downloaded.
"""

import json
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

from bundle import HASHES, ROOT, pinned
from packaging.utils import canonicalize_name

PYTHONS = ("3.11", "3.12", "3.13")
MACHINES = ("x86_64", "aarch64")
GLIBC = ("manylinux_2_28", "manylinux_2_27", "manylinux_2_26", "manylinux_2_24", "manylinux_2_17", "manylinux2014")
# Packages without wheels for other processors, where Numba takes another layer of threads.
ONE_PROCESSOR = {"tbb": "x86_64", "tcmlib": "x86_64"}


def main() -> None:
    """Write a line for each package: version, processor where there is one, digests."""
    versions, found = pinned(ROOT), defaultdict[str, set[str]](set)
    for machine in MACHINES:
        asked = {name: version for name, version in versions.items() if ONE_PROCESSOR.get(name, machine) == machine}
        for python in PYTHONS:
            for name, digest in wheels(asked, python, machine):
                found[name].add(digest)
    (ROOT / HASHES).write_text("".join(f"{line(name, versions[name], found[name])}\n" for name in sorted(versions)))


def line(name: str, version: str, digests: set[str]) -> str:
    """Return a requirement of pip with its digests."""
    marker = f" ; platform_machine == '{ONE_PROCESSOR[name]}'" if name in ONE_PROCESSOR else ""
    return " ".join([f"{name}=={version}{marker}", *(f"--hash=sha256:{digest}" for digest in sorted(digests))])


def wheels(versions: Mapping[str, str], python: str, machine: str) -> Iterator[tuple[str, str]]:
    """Yield name and SHA-256 of the wheel of each package."""
    with tempfile.TemporaryDirectory(prefix="hashes-") as folder:
        report = Path(folder, "report.json")
        command = [sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "--quiet", "--dry-run"]
        command += ["--report", str(report), "--no-deps", "--ignore-installed", "--only-binary=:all:"]
        command += ["--target", folder, "--python-version", python]
        command += [word for tag in GLIBC for word in ("--platform", f"{tag}_{machine}")]
        command += [f"{name}=={version}" for name, version in versions.items()]
        subprocess.run(command, check=True)  # noqa: S603 - pinned names
        installed = json.loads(report.read_text())["install"]
    for item in installed:
        yield canonicalize_name(item["metadata"]["name"]), item["download_info"]["archive_info"]["hashes"]["sha256"]


if __name__ == "__main__":
    main()
