"""Whether a scanner can have made a file, by the numbers that both state."""

from typing import NamedTuple

from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.inspections import InspectedReading
from sawmill_vocabulary.messages import N_

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
    pitches = (
        (N_("%(scanner)s mm between cells, the file has %(file)s mm"), "detector_pitch_mm"),
        (N_("%(scanner)s mm between rows, the file has %(file)s mm"), "row_pitch_mm"),
    )
    for sentence, name in pitches:
        in_scanner, stated = getattr(constants, name), getattr(reading, name)
        if in_scanner is not None and stated is not None and abs(stated - in_scanner) > SAME * in_scanner:
            return Misfit(sentence, in_scanner, stated, 3)
    return None
