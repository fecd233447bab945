"""The argument of a job's functions, and upper bounds of the memory and disk that several kinds need.

Bounds are generous and follow from sizes recorded when the scan was read; sizes that an unread file declares are not
used.
"""

from typing import TypeVar

from sawmill_calibration.scans.scan_rows import chosen_rows
from sawmill_contracts.handed_over import HandedOver
from sawmill_contracts.scanners import StoredScanner
from sawmill_contracts.scans import ScanShape
from sawmill_platform.attempts.protocol import Attempt, Needs
from sawmill_platform.contracts.base import Contract

Asked = TypeVar("Asked", bound=Contract)


class MillAttempt(Attempt[HandedOver]):
    """Attempt at a job of the mill."""

    @property
    def scanner(self) -> StoredScanner:
        """The scanner of the scan, or of the ask."""
        assert self.given.scanner is not None  # noqa: S101 - of a kind that has one
        return self.given.scanner

    def asked(self, contract: type[Asked]) -> Asked:
        """Read the job's own row as the contract that its kind answers with while it is unfinished."""
        assert self.given.asked_json is not None  # noqa: S101 - of a kind that is asked for
        return contract.model_validate_json(self.given.asked_json)


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
