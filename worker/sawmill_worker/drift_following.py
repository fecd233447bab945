"""Continuing drift charts in the worker itself: plain numbers of rows, no file, and a millisecond for each look."""

from typing import Any

from sawmill_contracts.choices import DriftMethod
from sawmill_contracts.scanner_drift import CountedLook, Followed


def follow_drift(
    state: dict[str, Any], method: DriftMethod, before: list[CountedLook], looks: list[CountedLook]
) -> Followed | None:
    """As `sawmill_worker.use_cases.drift.chart.follow`."""
    # A worker that is asked for no drift check holds no NumPy.
    from sawmill_worker.use_cases.drift.chart import follow  # noqa: PLC0415

    return follow(state, method, before, looks)
