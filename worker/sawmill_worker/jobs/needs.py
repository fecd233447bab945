"""What a job may need of memory and disk, from the sizes recorded when its scan was read and what was asked of it.

Each `jobs/<kind>.py` has a function `needs(attempt)`; this is what several of them share. They are upper bounds with
room to spare, for limits that an ordinary job never meets. What an unread file declares counts for nothing: the jobs
that read one have no needs beyond the limits that all have.
"""

from sawmill_contracts.scans import ScanShape
from sawmill_platform.attempts.work import Needs
from sawmill_worker.use_cases.selection import chosen_rows

# A process that has loaded everything: 0.34 GB were measured on two cores, 0.39 GB on eight.
PROCESS_BYTES = 2**29
# Sinograms, in double precision, that a calibration, a plan or a drift check keeps: 26 were measured.
SINOGRAMS = 100
# A file that does not grow with the job, and what HDF5 adds to one that does.
FILE_BYTES, FILE_SHARE = 2**30, 1.05


def of_averaged_rows(shape: ScanShape, rows: str | None, usable: tuple[int, int] | None) -> Needs:
    """All rows are read at once, may be copied, and some views of them are examined in double precision."""
    chosen = chosen_rows(rows, shape.rows, usable)
    stack = 4 * shape.views * (chosen.stop - chosen.start) * shape.detector
    sinograms = SINOGRAMS * 8 * shape.views * shape.detector
    return Needs(PROCESS_BYTES + 4 * stack + sinograms, FILE_BYTES + sinograms)
