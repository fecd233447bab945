"""Pooled results of drift checks: a line with its band for each calibration and method, in a panel of a chart."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from sawmill_contracts.measurements import Movement
from sawmill_contracts.scanner_drift import PooledDrift

# Standard deviations from the mean within which 95 % of a normal distribution lie.
DEVIATIONS = 2.0

Value = Callable[[Movement], float | None]


@dataclass(frozen=True)
class PooledValue:
    """A value pooled from a drift check and those before it, its standard deviation, and the value of the baseline."""

    value: Value
    deviation: Value
    zero: Callable[[PooledDrift], float | None]

    def has(self, one: Movement) -> bool:
        """Return whether a measurement has the pooled value."""
        return self.value(one) is not None


COLUMN = PooledValue(
    lambda one: one.pooled_cor_column_mm,
    lambda one: one.pooled_cor_column_standard_deviation_mm,
    lambda chart: chart.baseline_cor_column_mm,
)
TILT = PooledValue(
    lambda one: one.pooled_tilt_deg,
    lambda one: one.pooled_tilt_standard_deviation_deg,
    lambda chart: chart.baseline_tilt_deg,
)


def pooled_lines(
    together: PooledValue, samples: Sequence[tuple[float, float, Movement]], y: Callable[[float], float]
) -> Iterator[tuple[str, str]]:
    """Yield lines and the outlines of their bands, as `points` of SVG.

    Parameters
    ----------
    together
        Pooled value.
    samples
        Positions along the time, single values, and their measurements, the oldest first.
    y
        Function that returns the position of a value in the panel.
    """
    by_chart: dict[tuple[str | None, str | None], list[tuple[float, float, float]]] = {}
    for x, _, one in samples:
        value, deviation = together.value(one), together.deviation(one)
        if value is not None and deviation is not None:
            by_chart.setdefault((one.against_id, one.method), []).append((x, value, DEVIATIONS * deviation))
    for places in by_chart.values():
        upper = [(x, y(value + half)) for x, value, half in places]
        lower = [(x, y(value - half)) for x, value, half in reversed(places)]
        yield points((x, y(value)) for x, value, _ in places), points([*upper, *lower])


def points(places: Iterable[tuple[float, float]]) -> str:
    """Write points as SVG has them."""
    return " ".join(f"{x},{y}" for x, y in places)
