"""Places of the detector's cells that differ from equal distances on a straight line: an arc, or waves."""

import math
from collections.abc import Iterator

import numpy as np

from sawmill_tomography.calibration.joint_fit.effects import Effect
from sawmill_tomography.calibration.joint_fit.normal_equations import Column
from sawmill_tomography.calibration.joint_fit.scan_model import ARC, LEAST_CURVATURE, WAVES, ScanModel
from sawmill_tomography.geometry.detector_shape import waves
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import Adjustment
from sawmill_vocabulary.scan_messages import EffectMessage

# A detector with a smaller radius, in its own lengths, is none.
LEAST_RADIUS = 0.5
# Cells that are off by more, in cells, are in another order.
LARGEST_SHIFT = 2.0
# An error of the drawing turns with the phantom: this share of it resembles cells that are off.
STAYS = 0.25


def places_of_cells(cells: DetectorCells) -> Iterator[Effect]:
    """Yield the effects by which a detector's cells lie elsewhere, starting from these places."""
    bent = 0.0 if cells.arc_radius_mm is None else 1.0 / cells.arc_radius_mm
    yield Effect(
        Adjustment.CELL_PLACES,
        lambda _: (Column.of(ARC),),
        lambda _, sizes: EffectMessage.ARC(radius_mm=1.0 / max(bent + float(sizes[0]), LEAST_CURVATURE)),
        lambda model, sizes: (
            0.0 <= bent + sizes[0] < 1.0 / (LEAST_RADIUS * cells.count * cells.width_mm)
            and is_beyond_drawing(model, sizes[0] * model.rows_of_cells([ARC])[0])
        ),
    )
    known = np.pad(cells.waves_mm, (0, len(WAVES) - len(cells.waves_mm)))

    def shifts_mm(sizes: FloatArray) -> FloatArray:
        return waves(tuple(known + sizes), np.arange(cells.count), cells.count)

    yield Effect(
        Adjustment.CELL_PLACES,
        lambda _: tuple(map(Column.of, WAVES)),
        lambda _, sizes: EffectMessage.UNEVEN_CELLS(uneven_mm=math.sqrt(float((shifts_mm(sizes) ** 2).mean()))),
        lambda model, sizes: (
            bool(np.abs(shifts_mm(sizes)).max() <= LARGEST_SHIFT * cells.width_mm)
            and is_beyond_drawing(model, shifts_mm(sizes))
        ),
    )


def is_beyond_drawing(model: ScanModel, shifts_mm: FloatArray) -> bool:
    """Return whether cells are off by more than the shadow of a drawing that is off by a share of its precision."""
    return float((shifts_mm**2).mean()) > (STAYS * model.frame.magnification * model.drawing.precision_mm) ** 2
