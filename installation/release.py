"""The files of a release, in dist/VERSION (`make release`). Nothing outside of dist/ and build/ is changed.

Made of the commit that is checked out, which must carry the tag vVERSION; the version is that of the sources, the first
one in CHANGELOG.md, with a date, and that of the released contract. The figures of the pages must be newer than the
code that they measure; `make figures` lists those that are not. Made are the wheels of the product and of the generated
client, the source archive, the bundle for machines without a network, the image, a bill of materials (CycloneDX), the
licences of all packages, and checksums. All but the image are the same bytes for the same commit.

    python installation/release.py [--untagged] [--without-image]

`--untagged` tries it on a commit that is no release.
"""

import argparse
import gzip
import json
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

from bundle import ROOT, BundleError, build, output, sums

sys.path.append(str(ROOT / "docs/tools"))
from figures import read_results, stale

VERSION_FILE = "worker/sawmill_vocabulary/version.py"


class ReleaseError(Exception):
    """No release can be made of this commit; the sentence names the reason and the remedy."""


def main() -> int:
    """Check the commit and make the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--untagged", action="store_true", help="make the files although this commit is no release")
    parser.add_argument("--without-image", action="store_true", help="leave out the container image")
    options = parser.parse_args()
    try:
        version = version_of(ROOT)
        if not options.untagged:
            check(ROOT, version)
        folder = make(ROOT, version, image=not options.without_image)
    except (ReleaseError, BundleError, subprocess.CalledProcessError) as error:
        print(error, file=sys.stderr)
        return 1
    for path in sorted(folder.iterdir()):
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1e6:.1f} MB")
    return 0


def version_of(root: Path) -> str:
    """Return the version in the sources."""
    (version,) = re.findall(r'^VERSION = "(.+)"$', (root / VERSION_FILE).read_text(), re.MULTILINE)
    return str(version)


def check(root: Path, version: str) -> None:
    """Compare tag, version, changelog and contract, and the figures of the pages with what they measure.

    Raises
    ------
    ReleaseError
        They differ, files are not committed, or figures are stale.
    """
    tags = output("git", "tag", "--points-at", "HEAD", folder=root).split()
    heading = re.search(r"^## \[?([\d.]+)\]? - (.+)$", (root / "CHANGELOG.md").read_text(), re.MULTILINE)
    released = json.loads((root / "openapi/released.json").read_text())["info"]["version"]
    changed = output("git", "status", "--porcelain", folder=root)
    dated = heading and heading[1] == version and re.fullmatch(r"\d{4}-\d\d-\d\d", heading[2])
    faults = []
    if changed:
        faults.append("files are changed or new and not committed: commit or remove them")
    if f"v{version}" not in tags:
        faults.append(f"this commit has the tags {tags}, and must have v{version}: git tag v{version}")
    if not dated:
        shown = heading[0] if heading else "no version"
        faults.append(f"CHANGELOG.md begins with {shown!r}: it must be {version} with the date of the release")
    if released != version:
        faults.append(f"the released contract has version {released}: make release-contract writes {version}")
    faults += [f"stale figures, {line}" for line in stale(read_results(root / "benchmarks/results"), root)]
    if faults:
        raise ReleaseError("\n".join(faults))


def make(root: Path, version: str, *, image: bool) -> Path:
    """Make the files of a release and return their folder, which is emptied before."""
    folder = root / "dist" / version
    shutil.rmtree(folder, ignore_errors=True)
    archive = build(root, folder, root / "build/wheels")
    (folder / f"{archive.name}.sha256").unlink()
    with tarfile.open(archive) as bundle:
        for entry in bundle:
            path = Path(entry.name)
            if path.match("wheels/sawmill_calibration*.whl") or path.name in {"sbom.cdx.json", "LICENSES.txt"}:
                entry.name = path.name
                bundle.extract(entry, folder, filter="data")
    name = f"sawmill_calibration-{version}"
    source = subprocess.run(  # noqa: S603 - our own command
        ["git", "archive", f"--prefix={name}/", "HEAD"],  # noqa: S607
        cwd=root,
        check=True,
        stdout=subprocess.PIPE,
    )
    (folder / f"{name}.tar.gz").write_bytes(gzip.compress(source.stdout, mtime=0))
    if image:
        subprocess.run(["sh", root / "installation/image.sh", folder], check=True)  # noqa: S603, S607 - our own script
    (folder / "SHA256SUMS").write_text("".join(sums(folder)))
    return folder


if __name__ == "__main__":
    sys.exit(main())
