"""The numbers of the calibration that change nothing: each is set aside in turn, by a factor of four either way.

    python benchmarks/idle_limits.py [--scans 100] [--seed 1] [--part 3/31] [--only NAME] [--list]

A limit is a number, or several, that a module of `sawmill_tomography.calibration` names in capitals. The scans are
those of the study by family, in turns (`families.py`). A limit is idle where each scan's geometry, bound, verdict and
sentences stay the same to rounding. All limits with 100 scans take hours: `--part 3/31` takes the third of 31 parts.
`--list` prints the limits alone; `--only` takes those whose `module.NAME` has this in it.
"""

import argparse
import ast
import importlib
import pkgutil
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from families import outcome
from family_scans import FAMILIES
from rich.progress import track

from sawmill_tomography import calibration

FACTORS = (4.0, 0.25)


@dataclass(frozen=True)
class Limit:
    """A number of one module, and the modules that have it from there."""

    module: ModuleType
    name: str

    @property
    def label(self) -> str:
        """The module within the package, and the name."""
        return f"{self.module.__name__.removeprefix(calibration.__name__ + '.')}.{self.name}"

    def set(self, value: Any) -> None:  # noqa: ANN401 - of any limit
        """Give the limit another value wherever it is read, and forget what was computed with the one before."""
        for module in [self.module, *_importers(self)]:
            setattr(module, self.name, value)
        for module in _modules():
            for known in vars(module).values():
                if hasattr(known, "cache_clear"):
                    known.cache_clear()


def _modules() -> Iterator[ModuleType]:
    for found in pkgutil.walk_packages(calibration.__path__, calibration.__name__ + "."):
        if not found.name.endswith("_numba"):  # compiled with their constants
            yield importlib.import_module(found.name)


def _tree(module: ModuleType) -> ast.Module:
    assert module.__file__ is not None
    return ast.parse(Path(module.__file__).read_text())


def _importers(limit: Limit) -> Iterator[ModuleType]:
    for module in _modules():
        imports = [one for one in ast.walk(_tree(module)) if isinstance(one, ast.ImportFrom)]
        own = [one for one in imports if one.module == limit.module.__name__]
        if any(limit.name == alias.name for one in own for alias in one.names):
            yield module


def limits() -> Iterator[Limit]:
    """Yield the numbers that modules of the calibration name in capitals."""
    for module in _modules():
        assigned = [one.targets[0] for one in _tree(module).body if isinstance(one, ast.Assign)]
        assigned += [one.target for one in _tree(module).body if isinstance(one, ast.AnnAssign)]
        for one in assigned:
            for name in one.elts if isinstance(one, ast.Tuple) else [one]:
                if isinstance(name, ast.Name) and name.id.strip("_").isupper():
                    yield from [Limit(module, name.id)] if scaled(getattr(module, name.id), 1.0) is not None else []


def scaled(value: Any, factor: float) -> Any:  # noqa: ANN401 - of any limit
    """Return a number, or several, times a factor; whole numbers stay whole, from 1 on. None if there is no number."""
    if isinstance(value, (bool, str, Enum)):
        return None
    if isinstance(value, int):
        return max(round(value * factor), 1)
    if isinstance(value, (float, np.ndarray)):
        return value * factor
    if isinstance(value, (tuple, range)):
        parts = [scaled(part, factor) for part in value]
        return tuple(parts) if parts and None not in parts else None
    return None


def outcomes(scans: int, seed: int) -> list[dict[str, Any]]:
    """Return what the calibration says of the scans, or how it ends."""
    names = list(FAMILIES)
    return [_outcome(names[number % len(names)], number // len(names), seed) for number in range(scans)]


def _outcome(family: str, number: int, seed: int) -> dict[str, Any]:
    try:
        return outcome(family, number, seed)
    except Exception as error:  # noqa: BLE001 - without a limit, anything may fail
        return {"ended": repr(error)}


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Return whether two outcomes are the same but for rounding."""
    return one.keys() == other.keys() and all(
        abs(value - other[name]) <= 1e-6 * abs(value) if isinstance(value, float) else value == other[name]
        for name, value in one.items()
    )


def main() -> None:
    """Print how many scans each limit changes, the idle ones last."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--part", default="1/1", metavar="N/M")
    parser.add_argument("--only", default="", metavar="NAME")
    parser.add_argument("--list", action="store_true")
    options = parser.parse_args()
    part, parts = map(int, options.part.split("/"))
    tried = [limit for limit in limits() if options.only in limit.label][part - 1 :: parts]
    if options.list:
        print("\n".join(limit.label for limit in tried))
        return
    usual, idle = outcomes(options.scans, options.seed), []
    for limit in track(tried, description="limits"):
        value = getattr(limit.module, limit.name)
        changed = []
        for factor in FACTORS:
            limit.set(scaled(value, factor))
            found = outcomes(options.scans, options.seed)
            changed.append(sum(not same(one, other) for one, other in zip(usual, found, strict=True)))
        limit.set(value)
        print(f"{limit.label}: {changed[0]} and {changed[1]} of {options.scans} scans", flush=True)
        if not any(changed):
            idle.append(limit.label)
    print(f"{len(tried)} limits, of which {len(idle)} change nothing: {', '.join(idle)}")


if __name__ == "__main__":
    main()
