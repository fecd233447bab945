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


def log_rows(stack, angles_rad, scanner, theta, *, first_row=0, counts=False):
    """Of a stack (views, rows, detector)."""
    return LogRows(
        read=lambda start, stop: stack[:, start:stop],
        read_row=lambda row: stack[:, row - first_row],
        usable_rows=(first_row, first_row + stack.shape[1]),
        angles_rad=angles_rad,
        rows=(first_row, first_row + stack.shape[1]),
        row_step=1,
        scanner=scanner,
        counts=counts,
        sha256="0" * 64,
        remarks=(),
        theta=theta,
    )


def reconstruction_input(stack, fan, *, first_row=0, counts=False):
    """Of a stack (views, rows, detector) in this geometry."""
    scanner = ScannerConstants(**vars(fan.scanner))
    return log_rows(stack, fan.angles_rad, scanner, fan.theta, first_row=first_row, counts=counts)
