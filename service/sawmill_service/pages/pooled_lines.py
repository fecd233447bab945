"""What drift checks measured together: a line with its band for each calibration and method, in a panel of a chart."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from sawmill_contracts.measurements import Movement
from sawmill_contracts.scanner_drift import PooledDrift

# Of a normal distribution 95 % lie within.
DEVIATIONS = 2.0

Value = Callable[[Movement], float | None]


@dataclass(frozen=True)
class Together:
    """What a drift check measured together with those before it, its standard deviation, and what their baseline is."""

    value: Value
    deviation: Value
    zero: Callable[[PooledDrift], float | None]

    def has(self, one: Movement) -> bool:
        """Whether it is in a chart."""
        return self.value(one) is not None


COLUMN = Together(
    lambda one: one.pooled_cor_column_mm,
    lambda one: one.pooled_cor_column_standard_deviation_mm,
    lambda chart: chart.baseline_cor_column_mm,
)
TILT = Together(
    lambda one: one.pooled_tilt_deg,
    lambda one: one.pooled_tilt_standard_deviation_deg,
    lambda chart: chart.baseline_tilt_deg,
)


def pooled_lines(
    together: Together, known: Sequence[tuple[float, float, Movement]], y: Callable[[float], float]
) -> Iterator[tuple[str, str]]:
    """A line and the outline of its band, as `points` of SVG.

    Parameters
    ----------
    together
        Of which value.
    known
        Places along the time, single values, and whose they are, the oldest first.
    y
        The place of a value in the panel.
    """
    by_chart: dict[tuple[str | None, str | None], list[tuple[float, float, float]]] = {}
    for x, _, one in known:
        value, deviation = together.value(one), together.deviation(one)
        if value is not None and deviation is not None:
            by_chart.setdefault((one.against_id, one.method), []).append((x, value, DEVIATIONS * deviation))
    for places in by_chart.values():
        upper = [(x, y(value + half)) for x, value, half in places]
        lower = [(x, y(value - half)) for x, value, half in reversed(places)]
        yield points((x, y(value)) for x, value, _ in places), points([*upper, *lower])


def points(places: Iterable[tuple[float, float]]) -> str:
    """As SVG has them."""
    return " ".join(f"{x},{y}" for x, y in places)
