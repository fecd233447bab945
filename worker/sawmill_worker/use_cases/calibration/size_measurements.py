"""Objections of a phantom's measurements to its drawing, on the day of a calibration."""

from collections.abc import Iterator
from datetime import date

import numpy as np

from sawmill_contracts.phantoms import PhantomDrawing, SizeMeasurement
from sawmill_worker.use_cases.conversion import to_phantom

# A drawing contradicts a measurement if the two differ by more than this number of standard uncertainties.
CONTRADICTION = 3.0
AXES = {"x": 0, "y": 1}


def measurement_reasons(drawing: PhantomDrawing, today: date) -> Iterator[str]:
    """Yield a sentence for each measurement that has expired, and for each measurement that contradicts the drawing."""
    extent_mm = np.ptp(np.concatenate(to_phantom(drawing).outlines()), axis=0)
    for measured in drawing.measurements:
        if measured.expired(today):
            yield f"the phantom's measurement of {_described(measured)} expired on {measured.expires_on}: repeat it"
        axis = AXES.get(measured.what)
        if axis is None:
            continue
        drawn_mm = float(extent_mm[axis])
        if abs(drawn_mm - measured.measured_mm) > CONTRADICTION * measured.standard_uncertainty_mm:
            yield (
                f"the phantom is drawn {drawn_mm:.2f} mm along {measured.what} and was measured otherwise, "
                f"{_described(measured)}: draw it as measured, or the scale is wrong by as much"
            )


def _described(measured: SizeMeasurement) -> str:
    when = "" if measured.measured_on is None else f" on {measured.measured_on}"
    return f"{measured.what}, {measured.measured_mm:.2f} +- {measured.standard_uncertainty_mm:.2g} mm{when},"
