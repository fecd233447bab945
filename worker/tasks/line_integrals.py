"""A scan as read, in line integrals, prepared as asked."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worker.contracts.preparing import AirCorrection, FaultyCells, PrepareOptions, RingRemoval, RowAlignment
from worker.formats.canonical import CanonicalScan
from worker.tomography import air
from worker.tomography.geometry import FloatArray
from worker.tomography.preparing.missing_rows import RowShifts, aligned
from worker.tomography.preparing.preparation import Measures, prepare_rows
from worker.tomography.preparing.preprocess import line_integrals
from worker.tomography.preparing.row_mass import RowMoments, shifts_by_mass

Stack = NDArray[np.float32]

# The source's drift since the flat fields, at most: counts a quarter lower everywhere show no air.
LARGEST_DRIFT = 0.3


@dataclass(frozen=True, eq=False)
class PreparedScan:
    """What every later job uses.

    Attributes
    ----------
    stack : (views, rows, detector) float32
        Line integrals.
    air_level : (rows, detector) float32 or None
        Of counts, mean flat less mean dark; 0 where a cell was bridged.
    remarks : tuple of str
        What was done to the data, from reading on.
    row_shifts : (views,) float64 or None
        By how many rows each view was moved along the log; None where none was.
    """

    stack: Stack
    air_level: Stack | None
    remarks: tuple[str, ...]
    row_shifts: FloatArray | None = None


def as_line_integrals(read: CanonicalScan, options: PrepareOptions) -> PreparedScan:
    """Counts become line integrals; then faulty cells, air, rings and missing rows, as far as asked.

    What was read is taken over, so that a stack is in memory once: its projections are overwritten where they can be.

    Raises
    ------
    CountsError, RowsError
        The counts are none, or the views' rows cannot be laid over one another.
    """
    scan = _line_integrals(read)
    measures = _measures(options, counts=read.counts)
    of_object = np.ones(scan.stack.shape[2], bool)
    if not measures.none:
        stack = scan.stack if scan.stack.flags.writeable else scan.stack.copy()
        done = prepare_rows(stack, measures)
        level = None if scan.air_level is None else np.where(done.faulty, np.float32(0.0), scan.air_level)
        scan = PreparedScan(stack, level, (*scan.remarks, *done.remarks))
        of_object = ~done.air_cells if not done.air_cells.all() else of_object
    return (
        scan
        if options.align_rows is RowAlignment.OFF
        else _aligned(scan, read.angles_rad, options.align_rows, of_object)
    )


def _line_integrals(read: CanonicalScan) -> PreparedScan:
    if not read.counts or read.flats is None:
        return PreparedScan(read.projections, None, read.remarks)
    out = read.projections if read.projections.flags.writeable else None
    made = line_integrals(read.projections, read.flats, read.darks, out=out)
    return PreparedScan(made.stack, made.air_level, (*read.remarks, *made.remarks))


def _measures(options: PrepareOptions, *, counts: bool) -> Measures:
    by_kind = AirCorrection.VIEWS if counts else AirCorrection.OFF
    correction = by_kind if options.air is AirCorrection.AUTO else options.air
    bridging = options.faulty_cells is FaultyCells.BRIDGE or (options.faulty_cells is FaultyCells.AUTO and counts)
    return Measures(
        air=air.AirCorrection(correction),
        largest_air_level=LARGEST_DRIFT if options.air is AirCorrection.AUTO else math.inf,
        bridge_faulty_cells=bridging,
        remove_rings=options.rings is RingRemoval.SORTING,
    )


def _aligned(
    scan: PreparedScan, angles_rad: FloatArray, way: RowAlignment, of_object: NDArray[np.bool_]
) -> PreparedScan:
    shifts = _shifts(scan.stack, angles_rad, way, of_object)
    stack = aligned(scan.stack, shifts)
    # Moved rows have left their flat fields behind: what a cell counts in air is then what it counts in most rows.
    level = None if scan.air_level is None else np.tile(np.median(scan.air_level, axis=0), (stack.shape[1], 1))
    told = (
        f"views laid over one another by their {way.value}: {stack.shape[1]} of {scan.stack.shape[1]} rows are in all, "
        f"shifts 0 to {shifts.rows.max():.3g} {'whole ' if shifts.whole else ''}rows, standard deviation "
        f"{float(np.median(shifts.standard_deviation)):.2g}{'' if shifts.whole else '; resampled by cubic convolution'}"
    )
    return PreparedScan(stack, level, (*scan.remarks, told), shifts.rows)


def _shifts(stack: Stack, angles_rad: FloatArray, way: RowAlignment, of_object: NDArray[np.bool_]) -> RowShifts:
    if way is RowAlignment.PROFILE:
        return shifts_by_mass(RowMoments.of(stack, of_object), angles_rad)
    # OpenCV takes half a second to import, and few scans need it.
    from worker.tomography.preparing.matched_rows import shifts_by_features  # noqa: PLC0415

    return shifts_by_features(stack, angles_rad)
