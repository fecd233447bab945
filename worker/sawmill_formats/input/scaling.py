"""Values that a file stores as other numbers: value = scale x stored + offset."""

from dataclasses import dataclass
from math import isfinite
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage


@dataclass(frozen=True)
class Scaling:
    """The linear function that gives values of stored numbers, and the names under which the file states it."""

    scale: float = 1.0
    offset: float = 0.0
    names: str = ""

    @classmethod
    def of(cls, names: str, scale: float, offset: float, *, inverse: bool = False) -> Self | None:
        """Return this function or its inverse; None where a number cannot be used."""
        if inverse and scale:
            scale, offset = 1.0 / scale, -offset / scale
        return cls(scale, offset, names) if scale and isfinite(scale) and isfinite(offset) else None

    def apply(self, stored: NDArray[Any]) -> NDArray[Any]:
        """Make values of the stored numbers: in place, or in single precision where this is exact, else in double."""
        if (self.scale, self.offset) == (1.0, 0.0):
            return stored
        values = stored.astype(np.result_type(stored.dtype, np.float32), copy=False)
        values *= self.scale
        values += self.offset
        return values

    def remarks(self, path: str | None = None) -> tuple[Reason, ...]:
        """Return the remark that values of a dataset, or of the images, were unpacked, where a name states so."""
        if (self.scale, self.offset) == (1.0, 0.0) or not self.names:
            return ()
        numbers = {"names": self.names, "scale": f"{self.scale:.9g}", "offset": f"{self.offset:.9g}"}
        if path is None:
            return (ReadingMessage.PIXELS_UNPACKED(**numbers),)
        return (ReadingMessage.UNPACKED(path=path, **numbers),)
