"""Calibration of a scanner of fixed pairs, as commands and Python users ask for it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_calibration.failures import input_errors_translated, options_of, read_json, refused
from sawmill_calibration.known_geometry import drawing_of, to_phantom
from sawmill_calibration.scans.scan_rows import ScanRows, ScanSource, open_rows, part_of
from sawmill_contracts.fixed_pairs import BoardPose, CalibratedPair, FixedPairsOptions, FixedPairsResult
from sawmill_contracts.geometry import ReportedSourceFrame, SourceFrameDeviation
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.scans import UnregisteredScanOptions
from sawmill_tomography.calibration.phantom_rows import LEAST_SHADOW, segments
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.pairs.calibrate import FoundPair, FoundPairs, PairsTask, calibrate_pairs
from sawmill_tomography.pairs.passages import PairData
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import DataKind, Handedness, PairedScanner, ProgressCallback

# Groups of rows along the feed that show how a board's pose changes, each of `FEWEST` rows or more.
GROUPS, FEWEST = 3, 2
# A cell that is off the median of five cells by this share of the shadow in all rows is dead.
DEAD = 0.25


def read_paired_scanner(path: Path) -> PairedScanner:
    """Read a scanner of fixed pairs from a JSON file; refuse any other file with the code `geometry-file`."""
    with input_errors_translated():
        return read_json(path, PairedScanner, code="geometry-file", otherwise="no scanner of fixed pairs")


def calibrate_fixed_pairs(
    scans: Sequence[str | Path],
    scanner: PairedScanner | str | Path,
    phantom: Phantom | PhantomDrawing | str | Path,
    *,
    data: DataKind | str = DataKind.COUNTS,
    options: FixedPairsOptions | Mapping[str, object] | None = None,
    on_progress: ProgressCallback = lambda _: None,
) -> FixedPairsResult:
    """Find the geometry of all pairs of a scanner of fixed pairs, as `sawmill calibrate-pairs` does.

    Parameters
    ----------
    scans : sequence of path
        A file for each pair, in the order of the scanner's: the views are the passages, the rows run along the feed.
    scanner : PairedScanner, str or Path
        The nominal places of the pairs, or the path of their JSON file.
    phantom : Phantom, str or Path
        The board: a phantom, the name of a built-in one, or the path of a drawing (JSON).
    data : str
        Kind of the numbers, `counts` or `line-integrals`.
    options : dict, optional
        The side of the board and the tolerances, listed in docs/look-up/python.md#options-of-calibrate_fixed_pairs.
    on_progress : callable, optional
        Called with an object that has the `fraction` of the work that is done, from 0 to 1, and its `stage`.

    Raises
    ------
    ValueError
        `InputError`: a file, a scanner, a drawing or an option cannot be used; the message says what would be right.
    """
    given = scanner if isinstance(scanner, PairedScanner) else read_paired_scanner(Path(scanner))
    drawing = phantom if isinstance(phantom, PhantomDrawing) else drawing_of(phantom)
    chosen = options_of(FixedPairsOptions, options or {})
    if len(scans) != len(given.pairs):
        raise refused(
            "contradiction", f"the scanner has {len(given.pairs)} pairs: give a file for each, not {len(scans)}"
        )
    drawn = to_phantom(drawing)
    board = drawn if chosen.handedness is Handedness.AS_DRAWN else drawn.mirrored()
    stacks: list[NDArray[np.float32]] = []
    read: list[ScanRows] = []
    with input_errors_translated():
        for number, (path, pair) in enumerate(zip(scans, given.pairs, strict=True)):
            wanted = UnregisteredScanOptions(data=DataKind(data), detector_pitch_mm=pair.detector_pitch_mm)
            source, part = ScanSource(Path(path), wanted, turns=False), 0.5 / len(scans)
            report = part_of(on_progress, part * number, part * (number + 1))
            with open_rows(source, source_to_cor_mm=pair.source_distance_mm, on_progress=report) as rows:
                stacks.append(rows.stack())
                read.append(rows)
            if len(stacks[-1]) != len(stacks[0]):
                raise refused(
                    "contradiction",
                    f"{Path(path).name} has {len(stacks[-1])} passages, and the file before {len(stacks[0])}",
                )
        ranges = [board_rows(stack) for stack in stacks]
        # Where every file shows the board's beginning, heights count from there; else the pairs' stated offsets hold.
        begins = all(own.start > 1 for own in ranges)
        lines = []
        for stack, rows, own, pair in zip(stacks, read, ranges, given.pairs, strict=True):
            pitch = rows.scanner.row_pitch_mm
            begin_mm = 0.0 if begins else own.start * (pitch or 0.0) + pair.feed_offset_mm
            lines.append(_data_of(stack[:, own], pitch, DetectorCells.of(pair.scanner), begin_mm))
        middle = float(np.mean([one.heights_mm.mean() for one in lines]))
        task = PairsTask(
            given,
            board,
            [replace(one, heights_mm=one.heights_mm - middle) for one in lines],
            all(rows.counts for rows in read),
            chosen.corner_tolerance_mm,
            chosen.tolerance_mm,
            chosen.scale_tolerance_percent,
            chosen.log_radius_mm,
        )
        found = calibrate_pairs(task, on_progress=part_of(on_progress, 0.5, 1.0))
    return _result(found, ranges, board, chosen)


def board_rows(stack: NDArray[np.float32]) -> slice:
    """Return the longest run of rows of a stack (passages, rows, cells) that shows one body, without its two ends."""
    depth = np.nanmean(np.nanstd(stack, axis=2), axis=0)
    shadowed = np.concatenate([[False], depth > LEAST_SHADOW * float(np.nanmax(depth)), [False]])
    ends = np.flatnonzero(np.diff(shadowed.astype(int)))
    first, last = max(zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True), key=lambda run: run[1] - run[0])
    own = segments(stack[:, first:last])[0]
    cut = 1 if own.stop - own.start > 2 + FEWEST * GROUPS else 0
    return slice(first + own.start + cut, first + own.stop - cut)


def _data_of(stack: NDArray[np.float32], pitch_mm: float | None, cells: DetectorCells, begin_mm: float) -> PairData:
    """Return the means over groups of rows, which begin at this height; without a pitch there is one group."""
    groups = GROUPS if pitch_mm is not None and stack.shape[1] >= FEWEST * GROUPS else 1
    parts = np.array_split(np.arange(stack.shape[1]), groups)
    lines = np.stack([stack[:, part].mean(axis=1, dtype=np.float64) for part in parts], axis=1)
    return PairData(bridged(lines), np.array([part.mean() * (pitch_mm or 0.0) + begin_mm for part in parts]), cells)


def bridged(lines: FloatArray) -> FloatArray:
    """Return line integrals (..., cells) with dead cells, the same in all rows, interpolated from their neighbours."""
    middle = scipy.ndimage.median_filter(lines, size=(1,) * (lines.ndim - 1) + (5,), mode="nearest")
    off = np.abs(lines - middle) > DEAD * np.ptp(middle, axis=-1, keepdims=True)
    dead, cells = off.reshape(-1, off.shape[-1]).all(axis=0), np.arange(off.shape[-1])
    return np.apply_along_axis(lambda row: np.interp(cells, cells[~dead], row[~dead]), -1, lines)


def _result(found: FoundPairs, ranges: Sequence[slice], board: Phantom, options: FixedPairsOptions) -> FixedPairsResult:
    """Convert the answer of the science to the contract."""
    return FixedPairsResult(
        verdict=found.verdict,
        reasons=list(found.reasons),
        coded_reasons=[CodedReason.of(reason) for reason in found.reasons],
        predicted_rms_mm=found.rays.rms_mm,
        upper_95_mm=found.rays.upper_95_mm,
        scale_uncertainty_percent=found.scale_percent_95,
        pairs=[_pair(pair) for pair in found.pairs],
        passages=[BoardPose(x_mm=x, y_mm=y, roll_deg=math.degrees(roll)) for x, y, roll in found.poses],
        rows=[(own.start, own.stop) for own in ranges],
        corners_rms_mm=found.corners_mm,
        residual_percent=100.0 * found.left_share,
        log_radius_mm=found.radius_mm,
        phantom=board.name,
        outline_mm=[line.tolist() for line in board.centred().outlines()],
        options=options,
    )


def _pair(pair: FoundPair) -> CalibratedPair:
    names = [name for name in SourceFrameDeviation.model_fields if name != "magnification"]
    return CalibratedPair(
        source_frame=ReportedSourceFrame(**vars(pair.frame)),
        standard_deviation=SourceFrameDeviation(**dict(zip(names, pair.deviations, strict=True)), magnification=None),
        predicted_rms_mm=pair.rays.rms_mm,
        upper_95_mm=pair.rays.upper_95_mm,
        cell_order=pair.cell_order,
        order_deviations=pair.order_deviations,
    )
