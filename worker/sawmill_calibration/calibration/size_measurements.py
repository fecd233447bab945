"""Objections of a phantom's measurements to its drawing, on the day of a calibration."""

from collections.abc import Iterator
from datetime import date

import numpy as np

from sawmill_calibration.conversion import to_phantom
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_vocabulary.calibration_messages import CalibrationMessage
from sawmill_vocabulary.messages import Reason, Value

# A drawing contradicts a measurement if the two differ by more than this number of standard uncertainties.
CONTRADICTION = 3.0
AXES = {"x": 0, "y": 1}


def measurement_reasons(drawing: PhantomDrawing, today: date) -> Iterator[Reason]:
    """Yield a reason for each measurement that has expired, and for each measurement that contradicts the drawing."""
    extent_mm = np.ptp(np.concatenate(to_phantom(drawing).outlines()), axis=0)
    for measured in drawing.measurements:
        values: dict[str, Value] = {
            "what": measured.what,
            "measured_mm": measured.measured_mm,
            "error_mm": measured.standard_uncertainty_mm,
        }
        if measured.expired(today):
            yield CalibrationMessage.MEASUREMENT_EXPIRED(**values, expired_on=str(measured.expires_on))
        axis = AXES.get(measured.what)
        if axis is None:
            continue
        drawn_mm = float(extent_mm[axis])
        if abs(drawn_mm - measured.measured_mm) > CONTRADICTION * measured.standard_uncertainty_mm:
            yield CalibrationMessage.NOT_AS_MEASURED(**values, drawn_mm=drawn_mm)
