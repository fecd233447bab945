"""Write constraints.txt with the newest versions that pyproject.toml allows, and print what changed.

    python installation/newer_pins.py

pip resolves them in a new, empty environment. A pin that nothing needs here is kept: another Python or machine may need
it. `make test` then installs and tests the new versions.
"""

import json
import re
import subprocess
import sys
import tempfile
import tomllib
import venv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PINS = ROOT / "constraints.txt"
# Installed without its requirements (Makefile): it asks for an older typer, for its command line alone.
WITHOUT_TYPER = "openapi-python-client"


def main() -> None:
    """Write the pins and print the changes."""
    old = PINS.read_text()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    with tempfile.TemporaryDirectory(prefix="pins-") as folder:
        venv.create(folder, with_pip=True)
        pip = Pip(Path(folder))
        client = pip.resolved([WITHOUT_TYPER], "--no-deps")
        versions = pip.resolved([*requirements(project), *needs_of(client[0])]) + client
    newest = {item["metadata"]["name"]: item["metadata"]["version"] for item in versions}
    PINS.write_text(renewed(old, newest))
    print(*changes(old, PINS.read_text()) or ["All pins are the newest versions already."], sep="\n")


class Pip:
    """pip of an empty environment."""

    def __init__(self, environment: Path) -> None:
        self._environment = environment

    def resolved(self, wanted: Iterable[str], *flags: str) -> list[dict[str, Any]]:
        """Return pip's report of the packages that it would install."""
        report = self._environment / "report.json"
        command = [self._environment / "bin/python", "-m", "pip", "install", "--disable-pip-version-check", "--quiet"]
        command += ["--dry-run", "--ignore-installed", "--report", report]
        subprocess.run([*command, *flags, *wanted], check=True)  # noqa: S603 - the names of pyproject.toml
        found: list[dict[str, Any]] = json.loads(report.read_text())["install"]
        return found


def requirements(project: Mapping[str, Any]) -> list[str]:
    """Return the requirements of the product, of its extras and of its tests, without those that name the product."""
    texts = [*project["dependencies"], *(text for extra in project["optional-dependencies"].values() for text in extra)]
    return [text for text in texts if canonical(text) != project["name"]]


def needs_of(client: Mapping[str, Any]) -> list[str]:
    """Return the requirements of a resolved package, without typer and without extras."""
    needed = client["metadata"].get("requires_dist", [])
    return [text for text in needed if canonical(text) != "typer" and "extra ==" not in text]


def canonical(requirement: str) -> str:
    """Return the name in a requirement or a pin as registries compare it."""
    name = re.match(r"[\w.-]+", requirement)
    return re.sub(r"[-_.]+", "-", name[0]).lower() if name else ""


def renewed(old: str, newest: Mapping[str, str]) -> str:
    """Return the pins with newer versions and new packages, in the order of the names; names keep their spelling."""
    pins = dict(line.split("==") for line in old.split())
    spelled = {canonical(name): name for name in pins}
    pins |= {spelled.get(canonical(name), name): version for name, version in newest.items()}
    lines = [f"{name}=={version}\n" for name, version in pins.items()]
    return "".join(sorted(lines, key=lambda line: line.lower().replace("_", "-")))


def changes(old: str, new: str) -> list[str]:
    """Return a line for each pin that is new or has another version."""
    before, after = (dict(line.split("==") for line in text.split()) for text in (old, new))
    return [
        f"{name} {version}, new" if name not in before else f"{name} {before[name]} -> {version}"
        for name, version in after.items()
        if before.get(name) != version
    ]


if __name__ == "__main__":
    sys.exit(main())
