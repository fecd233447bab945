"""The arrays behind a calibration's answer: result.h5 stores them, and the pictures show them."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sawmill_vocabulary import ReconstructionMethod
from sawmill_vocabulary.messages import N_


class LogBefore(StrEnum):
    """Geometry of a log's reconstruction from before a calibration."""

    ACTIVE = "active"
    UNSHIFTED = "unshifted"

    @property
    def phrase(self) -> str:
        """Phrase for a title, which pages translate."""
        if self is LogBefore.ACTIVE:
            return N_("with the calibration that was active")
        return N_("uncalibrated: nothing shifted, nothing tilted")


@dataclass(frozen=True)
class LogImages:
    """Reconstructions (x, y) float32 of a row that shows a log: with this calibration, and with the geometry before.

    `field_mm` is the side of both images. `before_with` is the geometry of `before`: the calibration that was active
    or, where there was none, the scanner's constants with the calibrated detector distance, neither shifted nor
    tilted. `before` is None where such a geometry does not reconstruct.

    `field_mm` is the side of both images. `before_with` is the geometry of `before`: of the calibration that was active
    or, where there was none, of the scanner's constants with the detector as far away as it was found and neither
    shifted nor tilted. `before` is None where such a geometry does not reconstruct.
    """

    row: int
    field_mm: float
    after: NDArray[np.float32]
    before: NDArray[np.float32] | None
    before_with: LogBefore = LogBefore.ACTIVE


@dataclass(frozen=True)
class CalibrationArrays:
    """Arrays of result.h5, as docs/look-up/formats.md lists them."""

    # (view, detector) float32: in the unit of the scan; the residual is measured less model
    sinogram: NDArray[np.float32]
    model: NDArray[np.float32]  # (view, detector) float32
    residual: NDArray[np.float32]  # (view, detector) float32
    angles_rad: NDArray[np.float64]  # (view,): each view's angle as the scan gave it
    # (x, y) float32: the phantom with the geometry found, in units of its drawing's density; all 0 where there is no
    # image
    phantom_image: NDArray[np.float32]
    phantom_field_mm: float  # side of that image
    # (point, 2): the drawing's outlines where the phantom stood, each closed, a row of NaN between two
    phantom_outlines_mm: NDArray[np.float64]
    search_history: NDArray[np.float64]  # (step, 2): evaluations and the best value so far
    # Method of that image: FBP, or total variation where the views do not go all round
    phantom_image_method: ReconstructionMethod = ReconstructionMethod.FBP
    log: LogImages | None = None  # None where the scan shows no log beside the phantom

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Build the arrays from result.h5's by name; a number is an array of no dimensions.

        Raises
        ------
        ValueError
            A number is missing, a name is unknown, or an array has the wrong axes.
        """
        for name, axes in _AXES.items():
            values = arrays.get(name)
            if values is not None and (values.ndim != axes or values.dtype.kind not in "iuf"):
                raise ValueError(f"{name} must be numbers on {axes} axes, not {values.dtype} on {values.ndim}")
        log = None
        if "log_after" in arrays:
            log = LogImages(
                row=int(_number(arrays, "log_row")),
                field_mm=_number(arrays, "log_field_mm"),
                after=arrays["log_after"],
                before=arrays.get("log_before"),
                before_with=log_before_with(arrays),
            )
        # An earlier version had FBP alone.
        method = arrays.get("phantom_image_method", np.array(ReconstructionMethod.FBP.encode()))
        return cls(
            sinogram=arrays["sinogram"],
            model=arrays["model"],
            residual=arrays["residual"],
            angles_rad=arrays["angles_rad"],
            phantom_image=arrays["phantom_image"],
            phantom_field_mm=_number(arrays, "phantom_field_mm"),
            phantom_outlines_mm=arrays["phantom_outlines_mm"],
            search_history=arrays["search_history"],
            phantom_image_method=ReconstructionMethod(method.item().decode("ascii")),
            log=log,
        )


_AXES = {
    **dict.fromkeys(("sinogram", "model", "residual", "phantom_image", "phantom_outlines_mm", "search_history"), 2),
    **dict.fromkeys(("log_after", "log_before"), 2),
    "angles_rad": 1,
}


def _number(arrays: Mapping[str, NDArray[Any]], name: str) -> float:
    values = arrays[name]
    if values.shape != () or values.dtype.kind not in "iuf" or not np.isfinite(values):
        raise ValueError(
            f"{name} must be one number, not {values.dtype} of shape {values.shape} ({values.ravel()[:3]})"
        )
    return float(values)


def log_before_with(arrays: Mapping[str, NDArray[Any]]) -> LogBefore:
    """Read the name of `log_before`'s geometry in result.h5; an earlier version had only the active calibration's."""
    name = arrays.get("log_before_with")
    return LogBefore.ACTIVE if name is None else LogBefore(name.item().decode("ascii"))
