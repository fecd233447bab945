"""An archive with everything that an installation needs, for a machine without a network (`make bundle`).

`dist/sawmill-VERSION-PLATFORM-PYTHON.tar.gz` holds the wheels of the product, of the generated Python client and of
all that they need, as constraints.txt pins them, `install.sh`, the documents, a bill of materials (CycloneDX) and the
licences of all packages. It is made of the commit that is checked out: the same commit and the same wheels give the
same bytes.
"""

import gzip
import hashlib
import io
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import tomllib
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name, parse_wheel_filename
from packaging.version import Version
from shipped import bill_of_materials, licences

ROOT = Path(__file__).resolve().parents[1]
PYTHON = ".".join(platform.python_version_tuple()[:2])
# Files of the commit: documents to read without a network, and the script.
DOCUMENTS = (
    *(
        "README.md",
        "CHANGELOG.md",
        "CONTRIBUTING.md",
        "SECURITY.md",
        "LICENSE",
        "constraints.txt",
        "docker-compose.yml",
    ),
    *("docs", "examples", "openapi", "installation/install.sh"),
)
HASHES = Path("installation/hashes.txt")
# The generated client needs them (openapi/clients/templates/pyproject.toml.jinja).
CLIENT_NEEDS = ("attrs", "httpx")
# Size of an installation as a multiple of its unpacked wheels: bytecode, compiled kernels and pip are added.
ROOM = 1.5


class BundleError(Exception):
    """No bundle can be made; the sentence names what is missing."""


def main() -> int:
    """Build the archive below dist/, and the file with its checksum."""
    try:
        archive = build(ROOT, ROOT / "dist", ROOT / "build/wheels")
    except (BundleError, subprocess.CalledProcessError) as error:
        print(error, file=sys.stderr)
        return 1
    print(
        f"{archive.relative_to(ROOT)}: {archive.stat().st_size / 1e6:.0f} MB; its checksum is in {archive.name}.sha256"
    )
    return 0


def build(root: Path, target: Path, kept: Path) -> Path:
    """Build the archive of the commit that is checked out in `root`, in the folder `target`.

    Parameters
    ----------
    kept
        Folder where fetched wheels stay for the next bundle.

    Raises
    ------
    BundleError
        A package is not pinned or not installed, or its wheel has another digest.
    subprocess.CalledProcessError
        git or pip failed, and has printed why.
    """
    if output("git", "status", "--porcelain", "--untracked-files=no", folder=root):
        print("changes that are not committed are left out", file=sys.stderr)
    committed_at = int(output("git", "log", "-1", "--format=%ct", folder=root))
    with tempfile.TemporaryDirectory(prefix="bundle-") as temporary:
        source, content = Path(temporary, "source"), Path(temporary, "content")
        export(root, source)
        (content / "wheels").mkdir(parents=True)
        for name in DOCUMENTS:
            copy = shutil.copytree if (source / name).is_dir() else shutil.copy
            copy(source / name, content / Path(name).name)
        fetch(pinned(source), hashed(source), kept, content / "wheels")
        check(content / "wheels", hashed(source))
        make_wheels(source, content / "wheels", committed_at)
        wheels = sorted((content / "wheels").glob("*.whl"))
        facts = described(wheels)
        (content / "BUNDLE").write_text("".join(f"{name}={value}\n" for name, value in facts.items()))
        digests = {wheel.name: digest(wheel) for wheel in wheels}
        (content / "sbom.cdx.json").write_text(bill_of_materials(wheels, digests, committed_at))
        (content / "LICENSES.txt").write_text("".join(licences(wheels, (source / "LICENSE").read_text())))
        (content / "SHA256SUMS").write_text("".join(sums(content)))
        name = f"sawmill-{facts['version']}-{facts['platform']}-python{facts['python']}"
        target.mkdir(parents=True, exist_ok=True)
        archive = target / f"{name}.tar.gz"
        pack(content, name, archive, committed_at)
    archive.with_name(f"{archive.name}.sha256").write_text(f"{digest(archive)}  {archive.name}\n")
    return archive


def pinned(root: Path) -> dict[str, str]:
    """List the packages that product and client need, PostgreSQL's driver included, with their pinned versions.

    Raises
    ------
    BundleError
        A package is not pinned, or not installed, so that its own requirements are unknown.
    """
    pins = dict(line.split("==") for line in (root / "constraints.txt").read_text().split())
    versions = {canonicalize_name(name): version for name, version in pins.items()}
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    extras = (text for name in ("service", "celery", "postgresql") for text in project["optional-dependencies"][name])
    texts = (
        *project["dependencies"],
        *(text for text in extras if not text.startswith(project["name"])),
        *CLIENT_NEEDS,
    )
    asked = list(of_this_machine(texts, ()))
    found: dict[tuple[str, frozenset[str], bool], str] = {}
    while asked:
        requirement = asked.pop()
        name, extras, here = canonicalize_name(requirement.name), requirement.extras, requirement.marker is None
        if (name, frozenset(extras), here) in found:
            continue
        if name not in versions:
            msg = f"{name} is not in constraints.txt: pin it there"
            raise BundleError(msg)
        found[name, frozenset(extras), here] = versions[name]
        if here:
            asked += needs_of(name, extras)
    return {name: version for (name, _, _), version in found.items()}


def needs_of(name: str, extras: Iterable[str]) -> Iterator[Requirement]:
    """Return the requirements of an installed package with these extras."""
    try:
        return of_this_machine(distribution(name).requires or [], extras)
    except PackageNotFoundError as error:
        msg = f"{name} is not installed here: make install-dev installs it"
        raise BundleError(msg) from error


def of_this_machine(texts: Iterable[str], extras: Iterable[str]) -> Iterator[Requirement]:
    """Yield the requirements that hold on this machine, without markers, also for an earlier patch of the Python."""
    oldest = {"python_full_version": f"{PYTHON}.0"}
    for requirement in map(Requirement, texts):
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            requirement.marker = None
            yield requirement
        elif any(marker.evaluate({"extra": extra} | oldest) for extra in ("", *extras)):
            yield requirement


def export(root: Path, folder: Path) -> None:
    """Export the committed files, as they are in the repository."""
    archive = subprocess.run(["git", "archive", "HEAD"], cwd=root, check=True, stdout=subprocess.PIPE).stdout  # noqa: S607
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        tar.extractall(folder, filter="data")


def fetch(packages: Mapping[str, str], lines: Mapping[str, str], kept: Path, folder: Path) -> None:
    """Collect the wheels of these versions and digests; wheels that an earlier bundle fetched are reused."""
    kept.mkdir(parents=True, exist_ok=True)
    asked = {name: Version(version) for name, version in packages.items()}
    missing = [lines.get(name, name) for name in asked if name not in held(asked, kept)]
    if missing:
        (needed := kept / "missing.txt").write_text("\n".join(missing))
        pip("download", "--no-deps", "--only-binary=:all:", "--require-hashes", "--dest", kept, "--requirement", needed)
    for wheel in held(asked, kept).values():
        shutil.copy(wheel, folder)


def hashed(root: Path) -> dict[str, str]:
    """Return the lines of hashes.txt by package: requirements of pip, with the digest of each wheel."""
    return {line.split("==")[0]: line for line in (root / HASHES).read_text().splitlines()}


def check(folder: Path, lines: Mapping[str, str]) -> None:
    """Compare the wheels in a folder with their digests.

    Raises
    ------
    BundleError
        A wheel has another digest, or its package is not among the lines.
    """
    for wheel in sorted(folder.glob("*.whl")):
        if f"--hash=sha256:{digest(wheel)}" not in lines.get(parse_wheel_filename(wheel.name)[0], "").split():
            msg = f"{wheel.name} is not a wheel of {HASHES}: remove it from build/wheels. After make pins: make hashes"
            raise BundleError(msg)


def held(asked: Mapping[str, Version], folder: Path) -> dict[str, Path]:
    """Select the wheels in a folder that have these versions, by package."""
    names = {wheel: parse_wheel_filename(wheel.name) for wheel in sorted(folder.glob("*.whl"))}
    return {name: wheel for wheel, (name, version, _, _) in names.items() if asked.get(name) == version}


def make_wheels(source: Path, folder: Path, committed_at: int) -> None:
    """Build the wheels of the product and the generated client; they depend on the sources and the pins alone."""
    os.environ["SOURCE_DATE_EPOCH"] = str(committed_at)
    os.umask(0o022)  # a wheel has the modes of its files
    # With the pinned setuptools: a wheel names its version.
    pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, source)
    subprocess.run([sys.executable, source / "openapi/clients/generate.py", folder], check=True)  # noqa: S603 - our own


def pip(*arguments: str | Path) -> None:
    """Run one command of pip, with this machine's settings."""
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", arguments[0], "--quiet", *arguments[1:]]
    subprocess.run(command, check=True)  # noqa: S603 - our own command


def described(wheels: Sequence[Path]) -> dict[str, str]:
    """Return the values that `install.sh` compares with the machine, as variables of a shell."""
    (version,) = (wheel.name.split("-")[1] for wheel in wheels if wheel.name.startswith("sawmill_calibration-"))
    unpacked = sum(entry.file_size for wheel in wheels for entry in zipfile.ZipFile(wheel).infolist())
    return {
        "version": version,
        "python": PYTHON,
        "platform": sysconfig.get_platform(),
        "machine": platform.machine(),
        "glibc": ".".join(map(str, max(map(least_glibc, wheels)))),
        "megabytes": str(round(ROOM * unpacked / 1e6)),
    }


def least_glibc(wheel: Path) -> tuple[int, int]:
    """Return the oldest C library that one of the wheel's tags requires; at least 2.17, as Python 3.11's own pip."""
    aliases = {"manylinux1": "manylinux_2_5", "manylinux2010": "manylinux_2_12", "manylinux2014": "manylinux_2_17"}
    found = [(2, 17)]
    for tag in parse_wheel_filename(wheel.name)[3]:
        family, _, rest = tag.platform.partition("_")
        words = (f"{aliases[family]}_{rest}" if family in aliases else tag.platform).split("_")
        if words[0] == "manylinux":
            found.append((int(words[1]), int(words[2])))
    return min(found[1:], default=found[0])


def sums(content: Path) -> Iterator[str]:
    """Yield checksums as sha256sum(1) writes and checks them."""
    for path in sorted(path for path in content.rglob("*") if path.is_file()):
        yield f"{digest(path)}  {path.relative_to(content)}\n"


def digest(path: Path) -> str:
    """Compute SHA-256 in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def pack(content: Path, name: str, archive: Path, committed_at: int) -> None:
    """Pack a folder into an archive that depends on the folder's content alone."""
    with (
        archive.open("wb") as file,
        # Wheels are compressed already.
        gzip.GzipFile("", "wb", compresslevel=1, fileobj=file, mtime=committed_at) as packed,
        tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as tar,
    ):
        for path in sorted(content.rglob("*")):
            entry = tar.gettarinfo(path, f"{name}/{path.relative_to(content)}")
            entry.uid = entry.gid = 0
            entry.uname = entry.gname = "root"
            entry.mtime = committed_at
            entry.mode = 0o755 if path.is_dir() or path.suffix == ".sh" else 0o644
            with io.BytesIO() if path.is_dir() else path.open("rb") as data:
                tar.addfile(entry, data)


def output(*command: str, folder: Path) -> str:
    """Return the standard output of a git command."""
    done = subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE, text=True)  # noqa: S603 - our own
    return done.stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
