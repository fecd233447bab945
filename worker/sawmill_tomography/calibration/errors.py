"""The one error of a calibration."""


class CalibrationError(Exception):
    """No calibration could be made of this scan.

    Attributes
    ----------
    code : str
        Stable, for programs: wrong-shape, angles-mismatch, too-few-views, not-finite, flat-scan, no-geometry,
        phantom-outside-field, phantom-not-found.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code
