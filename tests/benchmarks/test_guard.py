"""Which rows the speed guard calls red."""

from collections.abc import Callable

import pytest
from guard import red

Seconds = dict[str, float]


def lasting(*clock_s: float, processor_s: float = 1.0) -> Callable[[], Seconds]:
    """Measurements one after another; the last one again and again."""
    left = list(clock_s)
    return lambda: {"processor": processor_s, "clock": left.pop(0) if len(left) > 1 else left[0]}


@pytest.mark.parametrize(
    ("now", "is_red"),
    [
        (lasting(1.2), False),
        (lasting(1.3), True),
        (lasting(2.0, 2.0, 2.0, 2.0, 1.2), False),  # one quiet measurement of five is enough
        (lasting(*[1.3] * 5, 1.2), False),  # slower once
        (lasting(1.0, processor_s=1.3), True),  # the other core does what the clock does not show
    ],
)
def test_a_row_is_red_that_is_a_quarter_slower_twice_in_a_row(now: Callable[[], Seconds], *, is_red: bool) -> None:
    rows = {"a row": now, "another row": lasting(1.0)}

    assert red(rows, dict.fromkeys(rows, lasting(1.0))) == (["a row"] if is_red else [])
