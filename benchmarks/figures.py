"""The figures of the pages, from `benchmarks/results`.

    python benchmarks/figures.py

A page marks the place of a figure, and this program writes the text between the marks:

    <!-- figure NAME.key 2 s -->0.42 s<!-- end -->

NAME is the results file's, `key` one of its values (dots lead into nested ones), `2` the number of significant
digits, the rest a unit. Digits and unit may be left out. The key `run` is the sentence that says how the file was
measured. A value of several lines, as a table is, has separate lines. Times and tables of a file that was
measured on a busy machine are marked so. A time is known by its key, which ends with the unit; ratios, counts and
errors need no mark.
"""

import functools
import json
import operator
import re
from collections.abc import Mapping
from math import floor, log10
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
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
        value = conditions(file) if key == "run" else functools.reduce(operator.getitem, key.split("."), file["values"])
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
    return f"`{file['command']}`, commit {commit}, {file['date'][:10]}, {machine}{busy}"


def main() -> None:
    """Fill all pages and name those that changed."""
    results = read_results()
    for path in PAGES:
        page = path.read_text()
        if (new := filled(page, results)) != page:
            path.write_text(new)
            print(path.relative_to(ROOT))


if __name__ == "__main__":
    main()
