"""Figures for notebooks: a sinogram, a slice, a drift check; drawn without pyplot."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sawmill_calibration.pictures.panels import show_image
from sawmill_calibration.pictures.windows import Window, labelled_views, window_of
from sawmill_contracts.drifts import DriftResult

# A change beyond this number of standard deviations is a move (contracts.drifts.DriftResult.moved).
SIGNIFICANT = 3.0
DETECTOR_PARAMETERS = {
    "cor_column_mm": "COR on the detector, mm",
    "tilt_rad": "tilt of the detector, rad",
    "source_to_detector_mm": "source to detector, mm",
}


def sinogram_figure(
    sinogram: NDArray[np.floating[Any]], *, angles_deg: NDArray[np.float64], pitch_mm: float, title: str
) -> Figure:
    """Draw a sinogram (views, cells): views downwards with their angles in degrees, the detector to the right in mm."""
    views, cells = sinogram.shape
    figure = Figure(figsize=(8.0, 5.6), layout="constrained")
    ax = figure.add_subplot()
    half, window = cells * pitch_mm / 2, window_of(sinogram)
    extent = (-half, half, views - 0.5, -0.5)
    shown = ax.imshow(
        sinogram, cmap="gray", vmin=window[0], vmax=window[1], extent=extent, aspect="auto", interpolation="nearest"
    )
    ax.set_yticks(*zip(*labelled_views(angles_deg), strict=True))
    ax.set_xlabel("position on the detector, mm")
    ax.set_ylabel("angle of the view, degrees")
    ax.set_title(title)
    figure.colorbar(shown, ax=ax, label="line integral")
    return figure


def slice_figure(
    image: NDArray[np.floating[Any]],
    *,
    field_mm: float,
    centre_mm: tuple[float, float],
    unit: str,
    window: Window,
    title: str,
) -> Figure:
    """Draw a slice (x, y) in mm, x downwards and y to the right (docs/look-up/conventions.md#axes)."""
    figure = Figure(figsize=(6.8, 5.8), layout="constrained")
    ax = figure.add_subplot()
    shown = show_image(ax, image, field_mm, window, centre_mm=centre_mm)
    ax.set_title(title)
    figure.colorbar(shown, ax=ax, label=unit, shrink=0.9)
    return figure


def drift_figure(result: DriftResult) -> Figure:
    """Draw each parameter's change with three standard deviations; leave out parameters that the scan does not show."""
    deviation = result.change_standard_deviation
    shown = [name for name in DETECTOR_PARAMETERS if getattr(deviation, name) is not None]
    figure = Figure(figsize=(8.0, 1.2 + 1.0 * len(shown)), layout="constrained")
    figure.suptitle(
        f"change since the calibration, ± {SIGNIFICANT:g} standard deviations\n"
        f"rays moved {result.ray_change_mm:.2g} mm, tolerance {result.tolerance_mm:.2g} mm"
    )
    for ax, name in zip(np.atleast_1d(figure.subplots(len(shown), 1)), shown, strict=True):
        change, reach = getattr(result.change, name), SIGNIFICANT * getattr(deviation, name)
        ax.errorbar([change], [0.0], xerr=[reach], fmt="o", capsize=5)
        ax.axvline(0.0, color="0.6", linewidth=1.0)
        ax.set_yticks([])
        ax.set_xlabel(DETECTOR_PARAMETERS[name])
    return figure
