"""The input of a reconstruction, of line integrals in memory."""

from dataclasses import dataclass

from sawmill_calibration.known_geometry import GivenGeometry
from sawmill_calibration.scans.scan_rows import ScanRows
from sawmill_contracts.geometry import ScannerConstants
from sawmill_vocabulary import Theta


@dataclass(frozen=True, eq=False)
class LogRows(ScanRows):
    """Rows of a log, with the theta of their reconstruction."""

    theta: Theta | None = None

    @property
    def geometry(self):
        return GivenGeometry(self.scanner, self.theta)


def reconstruction_input(stack, fan, *, first_row=0, counts=False):
    """Of a stack (views, rows, detector) in this geometry."""
    rows = (first_row, first_row + stack.shape[1])
    return LogRows(
        lambda start, stop: stack[:, start:stop],
        lambda row: stack[:, row - first_row],
        usable_rows=rows,
        angles_rad=fan.angles_rad,
        rows=rows,
        row_step=1,
        scanner=ScannerConstants(**vars(fan.scanner)),
        counts=counts,
        sha256="0" * 64,
        remarks=(),
        theta=fan.theta,
    )
