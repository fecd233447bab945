"""Memory and disk that a job may need, from the sizes recorded when the scan was read and from the job's options.

Each `jobs/<kind>.py` has a function `needs(attempt)`; this module holds the parts that several kinds share. Needs are
generous upper bounds, for limits that an ordinary job never reaches. Sizes that an unread file declares are not used:
the jobs that read a file have no needs beyond the limits that all jobs have.
"""

from sawmill_calibration.scans.selection import chosen_rows
from sawmill_contracts.scans import ScanShape
from sawmill_platform.attempts.work import Needs

# Memory of a process that has loaded all modules: 0.34 GB were measured on two cores, 0.39 GB on eight.
PROCESS_BYTES = 2**29
# Number of sinograms, in double precision, that a calibration, a plan or a drift check keeps: 26 were measured.
SINOGRAMS = 100
# Size of a file that does not grow with the job, and of HDF5's overhead in a file that does.
FILE_BYTES, FILE_SHARE = 2**30, 1.05


def of_averaged_rows(shape: ScanShape, rows: str | None, usable: tuple[int, int] | None) -> Needs:
    """Compute the needs of averaging: all rows are read and may be copied, some views are held in double precision."""
    chosen = chosen_rows(rows, shape.rows, usable)
    stack = 4 * shape.views * (chosen.stop - chosen.start) * shape.detector
    sinograms = SINOGRAMS * 8 * shape.views * shape.detector
    return Needs(PROCESS_BYTES + 4 * stack + sinograms, FILE_BYTES + sinograms)
