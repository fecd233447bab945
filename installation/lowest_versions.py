"""Print the lowest versions that pyproject.toml allows, as constraints of pip: `lowest_versions.py > lowest.txt`."""

import re
import tomllib
from pathlib import Path

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
EXTRAS = ("service", "celery", "postgresql")


def lowest_versions() -> list[str]:
    """Return `name==version` for each requirement of the product; ValueError for one without a lower bound."""
    texts = [*PROJECT["dependencies"], *(text for extra in EXTRAS for text in PROJECT["optional-dependencies"][extra])]
    lowest = []
    for text in texts:
        bound = re.fullmatch(r"([\w.-]+)(?:\[\w+\])?>=([\d.]+)(;.*)?", text)
        if bound is not None:
            lowest.append(f"{bound[1]}=={bound[2]}{bound[3] or ''}")
        elif not text.startswith(f"{PROJECT['name']}["):
            raise ValueError(f"{text} has no lower bound: give the lowest version that `make lowest` has tested")
    return lowest


if __name__ == "__main__":
    print(*lowest_versions(), sep="\n")
