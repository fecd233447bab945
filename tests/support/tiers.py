"""Tiers of the suite: what `make test` runs, and what `make nightly` adds by the marker `nightly`."""

from collections.abc import Iterable
from typing import Any

import pytest


def first_by_day(number: int, values: Iterable[Any]) -> list[Any]:
    """Give parametrised values of which `make test` runs the first ones and `make nightly` the others."""
    return [
        value if index < number else pytest.param(value, marks=pytest.mark.nightly)
        for index, value in enumerate(values)
    ]


# The worker's attempts as children of a template, and as fresh processes.
both_ways = pytest.mark.parametrize("settings", [True, False], ids=["forked", "fresh"], indirect=True)
fresh_by_night = pytest.mark.parametrize(
    "settings",
    [pytest.param(True, id="forked"), pytest.param(False, id="fresh", marks=pytest.mark.nightly)],
    indirect=True,
)
