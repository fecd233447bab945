"""The figures of the pages, from `benchmarks/results`.

    python docs/tools/figures.py

A page marks the place of a figure, and this program writes the text between the marks:

    <!-- figure NAME.key 2 s -->0.42 s<!-- end -->

NAME is the results file's, `key` one of its values (dots lead into nested ones), `2` the number of significant
digits, the rest a unit. Digits and unit may be left out. The key `run` is the sentence that says how the file was
measured, the key `measured` its commit and date alone: a page has one of them for each file that it shows. A value of
several lines, as a table is, has separate lines. Times and tables of a file that was measured on a busy machine are
marked so. A time is known by its key, which ends with the unit; ratios, counts and errors need no mark.

Files whose measured folders have changed since their commit are listed; `make release` refuses them.
"""

import functools
import json
import operator
import re
import subprocess
from collections.abc import Callable, Mapping
from datetime import date
from math import floor, log10
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
PLACE = re.compile(
    r"(<!-- figure ([\w-]+)\.([\w.-]+)(?: (\d+))?(?: ([^\s<>][^<>]*?))? -->)(.*?)(<!-- end -->)", re.DOTALL
)
TIME = re.compile(r"_(?:h|min|s|ms|per_s)$")
BUSY = "busy machine"

Results = Mapping[str, Mapping[str, Any]]


def read_results(folder: Path = ROOT / "benchmarks/results") -> dict[str, dict[str, Any]]:
    """Read all results files, by name."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}


def filled(page: str, results: Results) -> str:
    """Write the figures into the text of a page.

    Raises
    ------
    LookupError
        A mark names a file or a value that does not exist.
    """
    return PLACE.sub(lambda place: place[1] + figure(*place.groups()[1:5], results=results) + place[7], page)


def figure(name: str, key: str, digits: str | None, unit: str | None, *, results: Results) -> str:
    """Format a value of a results file, or how the file was measured.

    Raises
    ------
    LookupError
        The file or the value does not exist.
    """
    try:
        file = results[name]
        about = ABOUT.get(key)
        value = about(file) if about else functools.reduce(operator.getitem, key.split("."), file["values"])
    except (KeyError, TypeError):
        raise LookupError(f"benchmarks/results has no {name}.{key}, which a page shows") from None
    busy = file["busy"]
    if "\n" in str(value):
        return f"\n{value}\n" + (f"\n*Measured on a {BUSY}.*\n" if busy else "")
    text = " ".join(filter(None, (rounded(value, digits), unit)))
    return f"{text} ({BUSY})" if busy and TIME.search(key) else text


def rounded(value: object, digits: str | None) -> str:
    """Write a number with some significant digits and a space between thousands, anything else as it is."""
    if digits is None or not isinstance(value, int | float):
        return str(value)
    short = float(f"{value:.{int(digits) - 1}e}")
    decimals = max(0, int(digits) - 1 - (floor(log10(abs(short))) if short else 0))
    return f"{short:_.{decimals}f}".replace("_", " ")


def conditions(file: Mapping[str, Any]) -> str:
    """Describe how a results file was measured."""
    busy = f", on a {BUSY}" if file["busy"] else ""
    commit = file["commit"].replace("-dirty", " with changes")
    machine = f"{file['cores']} cores ({file['machine']}) at a load of {file['load']} before the start"
    where = f"entered {file['entered']}, machine not recorded" if "entered" in file else machine
    return f"`{file['command']}`, commit {commit}, {file['date'][:10]}, {where}{busy}"


def measured(file: Mapping[str, Any]) -> str:
    """Write commit and date of a results file."""
    day = date.fromisoformat(file["date"][:10])
    how = "entered by hand" if "entered" in file else "measured"
    return f"{how} at {file['commit'].removesuffix('-dirty')[:8]} on {day.day} {day:%B %Y}"


ABOUT: Mapping[str, Callable[[Mapping[str, Any]], str]] = {"run": conditions, "measured": measured}


def stale(results: Results, root: Path = ROOT) -> list[str]:
    """List the results files whose measured folders have changed since their commit, a sentence each."""
    found = []
    for name, file in results.items():
        commit, folders = file["commit"].removesuffix("-dirty"), ", ".join(file["measures"])
        command = ["git", "-C", str(root), "log", "-1", "--format=%h", f"{commit}..", "--", *file["measures"]]
        log = subprocess.run(command, check=False, capture_output=True, text=True)  # noqa: S603 - our own
        if log.returncode:
            found.append(f"{name}: its commit {commit} is not in this repository: fetch it, or run {file['command']}")
        elif newest := log.stdout.strip():
            found.append(f"{name}: {folders} changed in {newest} after {commit}: run {file['command']}")
    return found


def main() -> None:
    """Fill all pages, name those that changed, and list the results that are stale."""
    results = read_results()
    for path in PAGES:
        page = path.read_text()
        if (new := filled(page, results)) != page:
            path.write_text(new)
            print(path.relative_to(ROOT))
    print("\n".join(["Stale results, which a release refuses:", *(stale(results) or ["none"])]))


if __name__ == "__main__":
    main()
