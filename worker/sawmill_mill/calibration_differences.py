"""Differences of two calibrations number by number, and whether a scanner can have made a file."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import NamedTuple

from sawmill_contracts.calibrations import FoundGeometry
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.inspections import InspectedReading
from sawmill_vocabulary import SourceFrame
from sawmill_vocabulary.messages import N_

# A difference lies within this many of its standard deviations with 95 %.
DEVIATIONS = 1.96


@dataclass(frozen=True)
class Difference:
    """A number of the source frame in two calibrations."""

    name: str  # field of `SourceFrame`; its ending is the unit, also of all values here
    first: float
    second: float
    change: float  # the second value less the first; of the first angle by the shorter way round
    # Bound of the change with 95 %, from both covariances; None where either calibration does not state it.
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
        yield Difference(name, before, after, change, None if None in spreads else DEVIATIONS * math.hypot(*spreads))


# Largest relative difference of two equal distances.
SAME = 1e-6


class Misfit(NamedTuple):
    """Numbers that contradict each other, the sentence about them, and the number of decimals to write."""

    sentence: str
    in_scanner: float
    in_file: float
    digits: int


def misfit(constants: ScannerConstants, reading: InspectedReading) -> Misfit | None:
    """Return the first contradiction between a scanner and a file; None where the scanner can have made the file."""
    cells, in_file = constants.num_detector_pixels, reading.shape.detector
    if cells != in_file:
        return Misfit(N_("%(scanner)s cells, the file has %(file)s"), cells, in_file, 0)
    for sentence, name in (
        (N_("%(scanner)s mm between cells, the file has %(file)s mm"), "detector_pitch_mm"),
        (N_("%(scanner)s mm between rows, the file has %(file)s mm"), "row_pitch_mm"),
    ):
        in_scanner, stated = getattr(constants, name), getattr(reading, name)
        if in_scanner is not None and stated is not None and abs(stated - in_scanner) > SAME * in_scanner:
            return Misfit(sentence, in_scanner, stated, 3)
    return None
