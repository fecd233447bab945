"""Units as files write them."""

import numpy as np
from numpy.typing import NDArray

from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage

# The micro sign, and the Greek letter.
_MICRONS = "um \u00b5m \u03bcm micron microns micrometer micrometers micrometre micrometres"
_UNITS_MM = {
    "nm nanometer nanometers nanometre nanometres": 1e-6,
    _MICRONS: 1e-3,
    "mm millimeter millimeters millimetre millimetres": 1.0,
    "cm centimeter centimeters centimetre centimetres": 10.0,
    "in inch inches": 25.4,
    "m meter meters metre metres": 1000.0,
}
LENGTHS_MM = {name: mm for names, mm in _UNITS_MM.items() for name in names.split()}
DEGREES = {"deg", "degree", "degrees", "°"}
RADIANS = {"rad", "radian", "radians"}
# Distances between cells, in mm: from a nanometre to a metre.
LEAST_PITCH_MM, LARGEST_PITCH_MM = 1e-6, 1000.0


def to_mm(value: float, unit: str) -> float | None:
    """Convert a length to mm; None for a unit that is not one of length."""
    factor = LENGTHS_MM.get(unit.strip().lower())
    return None if factor is None else value * factor


def to_degrees(values: NDArray[np.float64], unit: str) -> NDArray[np.float64] | None:
    """Convert angles to degrees; None for a unit that is not one of angle."""
    name = unit.strip().lower()
    if name in DEGREES:
        return values
    with np.errstate(over="ignore"):  # values that become infinite are refused with their place
        return np.rad2deg(values) if name in RADIANS else None


def length_of(values: NDArray[np.float64], unit: str | None) -> tuple[float | None, Reason | None]:
    """Return one length in mm, or None and the reason why it cannot be used."""
    if values.size != 1:
        return None, ReadingMessage.LENGTH_OF_SEVERAL(values=values.size)
    if unit is None:
        return None, ReadingMessage.LENGTH_WITHOUT_UNIT()
    length_mm = to_mm(float(values.reshape(-1)[0]), unit)
    if length_mm is None:
        return None, ReadingMessage.LENGTH_OF_OTHER_UNIT(unit=unit)
    if length_mm == 0.0 or np.isnan(length_mm):
        # Exporters write such a size where they do not know it.
        return None, ReadingMessage.LENGTH_STATES_NOTHING(length_mm=f"{length_mm:g}")
    return length_mm, None
