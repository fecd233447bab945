"""Calibration of a scanner of fixed pairs, as commands and Python users ask for it."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_calibration.failures import InputError, input_errors_translated, options_of, read_json, refused
from sawmill_calibration.known_geometry import drawing_of, to_phantom
from sawmill_calibration.scans.scan_rows import ScanRows, ScanSource, open_rows, part_of
from sawmill_contracts.fixed_pairs import MOST_PASSAGES, BoardPose, CalibratedPair, FixedPairsOptions, FixedPairsResult
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
from sawmill_vocabulary import DataKind, FixedPair, Handedness, PairedScanner, ProgressCallback

# Groups of rows along the feed that show how a board's pose changes, each of `FEWEST` rows or more.
GROUPS, FEWEST = 3, 2
# A cell that is off the median of five cells by this share of the shadow in all rows is dead.
DEAD = 0.25


def read_paired_scanner(path: Path) -> PairedScanner:
    """Read a scanner of fixed pairs from a JSON file; refuse any other file with the code `geometry-file`."""
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
        Passages that were recorded apart have such files each, one passage after the other.
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
    sources = sources_of([Path(path) for path in scans], given, DataKind(data))
    return calibrate_passages(sources, given, drawing, options_of(FixedPairsOptions, options or {}), on_progress)


def sources_of(
    paths: Sequence[Path], scanner: PairedScanner, data: DataKind, *, uploaded: bool = False
) -> list[ScanSource]:
    """Return how the files of passages are read.

    Parameters
    ----------
    paths : sequence of Path
        The files, as `calibrate_passages` takes them.
    scanner : PairedScanner
        The pairs, whose cells have the pitch of the files.
    data : DataKind
        Kind of the numbers in all files.
    uploaded : bool
        Whether a confined process reads them, which starts no other one.

    Raises
    ------
    InputError
        The number of files is no multiple of the number of pairs.
    """
    pairs = scanner.pairs
    if not paths or len(paths) % len(pairs):
        raise refused("contradiction", f"the scanner has {len(pairs)} pairs: give a file for each, not {len(paths)}")
    wanted = [UnregisteredScanOptions(data=data, detector_pitch_mm=pair.detector_pitch_mm) for pair in pairs]
    of_pairs = wanted * (len(paths) // len(pairs))
    return [ScanSource(*each, turns=False, uploaded=uploaded) for each in zip(paths, of_pairs, strict=True)]


def calibrate_passages(
    sources: Sequence[ScanSource],
    scanner: PairedScanner,
    drawing: PhantomDrawing,
    options: FixedPairsOptions,
    on_progress: ProgressCallback,
) -> FixedPairsResult:
    """Find the geometry of all pairs of a scanner of fixed pairs: commands, Python users and jobs call it.

    Parameters
    ----------
    sources : sequence of ScanSource
        A file for each pair, or one for each in every passage, passage by passage (`sources_of`).
    scanner : PairedScanner
        The nominal places of the pairs.
    drawing : PhantomDrawing
        The board.
    options : FixedPairsOptions
        The side of the board and the tolerances.
    on_progress : callable
        Called with the progress of reading and of the fit.

    Raises
    ------
    InputError
        A file cannot be used; the sentence begins with its pair and, of several, its passage.
    """
    pairs = scanner.pairs
    drawn = to_phantom(drawing)
    board = drawn if options.handedness is Handedness.AS_DRAWN else drawn.mirrored()
    files: list[list[_PassageFile]] = [[] for _ in pairs]
    read = read_passages(sources, scanner, part_of(on_progress, 0.0, 0.5))
    for of_pair, (named, rows, stack) in zip(cycle(files), read, strict=False):
        with _named(named):
            of_pair.append(_PassageFile(rows, stack, board_rows(stack)))
        shown, others = len(stack), len(files[0][-1].stack)
        if shown * (len(sources) // len(pairs)) > MOST_PASSAGES:
            raise refused(
                "contradiction",
                f"{named} has {shown} views in its file, and a calibration takes at most {MOST_PASSAGES} passages: is "
                "it a scan of something that turns?",
            )
        if shown != others:
            raise refused("contradiction", f"{named} has {shown} passages in its file, and pair 1 has {others}")
    # Where every file shows the board's beginning, heights count from there; else the pairs' stated offsets hold.
    begins = all(file.board.start > 1 for of_pair in files for file in of_pair)
    lines = [_data_of(of_pair, pair, begins=begins) for of_pair, pair in zip(files, pairs, strict=True)]
    middle = float(np.mean([one.heights_mm.mean() for one in lines]))
    task = PairsTask(
        scanner,
        board,
        [replace(one, heights_mm=one.heights_mm - middle) for one in lines],
        all(file.rows.counts for of_pair in files for file in of_pair),
        options.corner_tolerance_mm,
        options.tolerance_mm,
        options.scale_tolerance_percent,
        options.log_radius_mm,
    )
    with input_errors_translated():
        found = calibrate_pairs(task, on_progress=part_of(on_progress, 0.5, 1.0))
    return _result(found, [of_pair[0].board for of_pair in files], board, options)


@contextmanager
def _named(file: str) -> Iterator[None]:
    """Begin the sentence of a refusal with the file's place among the others."""
    try:
        with input_errors_translated():
            yield
    except InputError as error:
        raise refused(error.code, f"{file}: {error.detail}") from error


def read_passages(
    sources: Sequence[ScanSource], scanner: PairedScanner, on_progress: ProgressCallback
) -> Iterator[tuple[str, ScanRows, NDArray[np.float32]]]:
    """Read files of `sources_of`: the name in sentences, the rows, and the line integrals (views, rows, cells)."""
    for number, source in enumerate(sources):
        passage, place = divmod(number, len(scanner.pairs))
        pair = scanner.pairs[place]
        report = part_of(on_progress, number / len(sources), (number + 1) / len(sources))
        named = f"pair {place + 1}" + (f", passage {passage + 1}" if len(sources) > len(scanner.pairs) else "")
        with _named(named), open_rows(source, source_to_cor_mm=pair.source_distance_mm, on_progress=report) as rows:
            stack = rows.stack()
        cells, due = stack.shape[-1], pair.num_detector_pixels
        if cells != due:
            raise refused("other-detector", f"{named} has {cells} cells in its scan, and num_detector_pixels is {due}")
        yield named, rows, stack


class _PassageFile(NamedTuple):
    """One file of a pair: its rows, and which of them show the board."""

    rows: ScanRows
    stack: NDArray[np.float32]
    board: slice


def board_rows(stack: NDArray[np.float32]) -> slice:
    """Return the longest run of rows of a stack (passages, rows, cells) that shows one body, without its two ends."""
    depth = np.nanmean(np.nanstd(stack, axis=2), axis=0)
    shadowed = np.concatenate([[False], depth > LEAST_SHADOW * float(np.nanmax(depth)), [False]])
    ends = np.flatnonzero(np.diff(shadowed.astype(int)))
    if not ends.size:
        raise refused("geometry", "no row shows anything but air: pass the board between source and detector")
    first, last = max(zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True), key=lambda run: run[1] - run[0])
    own = segments(stack[:, first:last])[0]
    cut = 1 if own.stop - own.start > 2 + FEWEST * GROUPS else 0
    return slice(first + own.start + cut, first + own.stop - cut)


def _data_of(files: Sequence[_PassageFile], pair: FixedPair, *, begins: bool) -> PairData:
    """Return a pair's means over groups of rows that all its files show; without a row pitch there is one group."""
    pitch_mm, ranges = files[0].rows.scanner.row_pitch_mm, [file.board for file in files]
    if not begins:
        ranges = [slice(max(own.start for own in ranges), min(own.stop for own in ranges))] * len(files)
    if (count := min(own.stop - own.start for own in ranges)) < 1:
        raise refused("rows-missing", "the passages show the board in rows that no two files share: begin them alike")
    stack = np.concatenate([file.stack[:, own.start :][:, :count] for file, own in zip(files, ranges, strict=True)])
    parts = np.array_split(np.arange(count), GROUPS if pitch_mm is not None and count >= FEWEST * GROUPS else 1)
    lines = np.stack([stack[:, part].mean(axis=1, dtype=np.float64) for part in parts], axis=1)
    begin_mm = 0.0 if begins else ranges[0].start * (pitch_mm or 0.0) + pair.feed_offset_mm
    heights_mm = np.array([part.mean() * (pitch_mm or 0.0) + begin_mm for part in parts])
    return PairData(bridged(lines), heights_mm, DetectorCells.of(pair.scanner))


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
