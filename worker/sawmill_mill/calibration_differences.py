"""Differences of two calibrations of one scanner, number by number, each with its error bar."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields

from sawmill_contracts.calibrations import FoundGeometry
from sawmill_vocabulary import SourceFrame

# A difference lies within this many of its standard deviations with 95 %.
DEVIATIONS = 1.96


@dataclass(frozen=True)
class Difference:
    """A number of the source frame in two calibrations.

    Attributes
    ----------
    name : str
        Field of `SourceFrame`; its ending is the unit, and that of all values here.
    change : float
        The second value less the first; of the first angle by the shorter way round.
    error : float or None
        Bound of the change with 95 %, from both covariances; None where either calibration does not state it.
    """

    name: str
    first: float
    second: float
    change: float
    error: float | None

    @property
    def is_certain(self) -> bool | None:
        """True if the change is larger than its error; None where the error is not known."""
        return None if self.error is None else abs(self.change) > self.error


def differences(first: FoundGeometry, second: FoundGeometry) -> Iterator[Difference]:
    """Compare the source frames of two calibrations; scans are independent, so their variances add up."""
    for name in (field.name for field in fields(SourceFrame)):
        before, after = (getattr(each.source_frame, name) for each in (first, second))
        spreads = [getattr(each.deviations.source_frame, name) for each in (first, second)]
        change = math.remainder(after - before, math.tau) if name == "psi_rad" else after - before
        error = None if None in spreads else DEVIATIONS * math.hypot(*spreads)
        yield Difference(name, before, after, change, error)
