"""View angles as people give them: START:STEP, a list, or a text file."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, check_regular, quoted
from sawmill_formats.input.plausible import LARGEST_ANGLE_DEG

LARGEST_ANGLES_FILE_BYTES = 16 * 2**20


@dataclass(frozen=True)
class AngleSteps:
    """Equidistant angles, for as many views as the scan turns out to have."""

    start_deg: float
    step_deg: float

    def expand(self, views: int) -> NDArray[np.float64]:
        """Return the angles, (views,) float64, degrees."""
        return self.start_deg + self.step_deg * np.arange(views, dtype=np.float64)


@dataclass(frozen=True)
class AngleList:
    """A list with an angle for each view."""

    values_deg: tuple[float, ...]

    def expand(self, views: int) -> NDArray[np.float64]:
        """Return the angles, (views,) float64, degrees: `angles-mismatch` for another number of views."""
        if len(self.values_deg) != views:
            raise UnreadableScan(
                "angles-mismatch",
                f"{len(self.values_deg)} angles were given for {views} views; give one angle for each view",
            )
        return np.array(self.values_deg, dtype=np.float64)


AnglesGiven = AngleSteps | AngleList


def parse_angles(text: str) -> AnglesGiven:
    """Read `0.5:1` (start and step) or `0,1,2` (every view's angle), in degrees.

    A comma between start and step, or in a list with semicolons, is a decimal one: `0,5:1` and `0,5; 1,5`.

    Raises
    ------
    UnreadableScan
        `angles-malformed`, when the text is neither.
    """
    if ":" not in text:
        items = text.replace(",", ".").split(";") if ";" in text else text.split(",")
        return AngleList(tuple(_number(item) for item in items))
    parts = text.replace(",", ".").split(":")
    if len(parts) != 2:
        raise UnreadableScan("angles-malformed", f"angles must be START:STEP, as in 0.5:1, not {quoted(text)!r}")
    start, step = _number(parts[0]), _number(parts[1])
    if step == 0:
        raise UnreadableScan("angles-malformed", "the step between two views must not be 0 degrees")
    return AngleSteps(start, step)


def read_angles_file(path: Path) -> AngleList:
    """Read a text file with one angle in degrees on each line, `#` starts a comment: `angles-malformed`."""
    check_regular(path)
    if path.stat().st_size > LARGEST_ANGLES_FILE_BYTES:
        raise UnreadableScan("angles-malformed", f"{path.name} is too large for a list of angles, one on each line")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise UnreadableScan("angles-malformed", f"{path.name} is not a text with one angle on each line") from error
    values = tuple(_number(number) for line in text.splitlines() if (number := line.partition("#")[0].strip()))
    if not values:
        raise UnreadableScan("angles-malformed", f"{path.name} holds no angle; write one on each line, in degrees")
    return AngleList(values)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UnreadableScan(
            "angles-malformed",
            f"an angle must be a number of degrees, not {quoted(text)!r}; "
            "give START:STEP, as in 0.5:1, or one for each view",
        )
    if abs(value) > LARGEST_ANGLE_DEG:
        raise UnreadableScan(
            "angles-malformed",
            f"an angle is {value:g} degrees; it must be between {-LARGEST_ANGLE_DEG:.0f} and {LARGEST_ANGLE_DEG:.0f}",
        )
    return value
