"""The only exception of a calibration."""


class CalibrationError(Exception):
    """A failed calibration: this scan has none.

    `code`, for programs, is stable: other-detector, angles-mismatch, too-few-views, not-finite, flat-scan, no-geometry,
    phantom-outside-field, phantom-not-seen.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code
