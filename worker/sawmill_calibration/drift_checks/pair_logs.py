"""Logs on a scanner of fixed pairs: marks in three dimensions, whether the pairs still agree, and scans for images."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sawmill_calibration.calibration.fixed_pairs import bridged, read_paired_scanner, read_passages, sources_of
from sawmill_calibration.failures import input_errors_translated, read_json, refused
from sawmill_calibration.scans.scan_rows import ScanSource, unreported
from sawmill_calibration.view_vectors import vectors_of
from sawmill_contracts.fixed_pairs import FixedPairsResult
from sawmill_contracts.pair_logs import LogOnPairs
from sawmill_formats.output.scan_writer import new_scan
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.pairs.agreement import agreement
from sawmill_tomography.pairs.log_pictures import LogPictures, log_pictures
from sawmill_tomography.pairs.marks import Sights
from sawmill_tomography.statistics import TWO_SIDED_95
from sawmill_vocabulary import CellOrder, DataKind, PairedScanner, ProgressCallback
from sawmill_vocabulary.pairs import LocatedMark


def locate_marks(
    scans: Sequence[str | Path],
    scanner: str | Path,
    calibration: str | Path,
    *,
    data: DataKind | str = DataKind.COUNTS,
    tolerance_mm: float = 1.0,
    aligned: Path | None = None,
    on_progress: ProgressCallback = unreported,
) -> LogOnPairs:
    """Find marks of a log that passed a scanner of fixed pairs once, and check the pairs by it.

    Parameters
    ----------
    scans : sequence of path
        A file for each pair, in the order of the scanner's, with one view; the rows run along the feed.
    scanner : path
        JSON of the pairs with their cells and offsets along the feed.
    calibration : path
        What `sawmill calibrate-pairs --json` printed.
    data : str
        Kind of the numbers, `counts` or `line-integrals`.
    tolerance_mm : float
        The pairs agree where none can have moved by more than this, with 95 %.
    aligned : Path, optional
        File of a scan with the log's rows by all pairs, for reconstructions; its geometry is written next to it as
        JSON.
    on_progress : callable, optional
        Called with an object that has the `fraction` of the work that is done, from 0 to 1, and its `stage`.

    Raises
    ------
    ValueError
        `InputError`: a file cannot be used, or the log leaves a detector.
    """
    given = read_paired_scanner(Path(scanner))
    otherwise = "no answer of calibrate-pairs --json"
    known = read_json(Path(calibration), FixedPairsResult, code="calibration", otherwise=otherwise)
    if aligned is not None and aligned.with_suffix(".json").absolute() in (
        Path(file).absolute() for file in (scanner, calibration)
    ):
        raise refused("contradiction", f"the geometry of {aligned.name} would replace a file that is read: rename it")
    sources = sources_of([Path(path) for path in scans], given, DataKind(data))
    return log_on_pairs(sources, given, known, tolerance_mm, on_progress, aligned)


def log_on_pairs(
    sources: Sequence[ScanSource],
    scanner: PairedScanner,
    known: FixedPairsResult,
    tolerance_mm: float,
    on_progress: ProgressCallback,
    aligned: Path | None = None,
) -> LogOnPairs:
    """Find marks of a log by a file for each pair (`sources_of`), as `locate_marks` does, and raise what it raises."""
    if not len(sources) == len(scanner.pairs) == len(known.pairs):
        numbers = f"{len(sources)} files, {len(scanner.pairs)} pairs, and {len(known.pairs)} calibrated ones"
        raise refused("contradiction", f"a log passes once, a file for each pair: there are {numbers}")
    stacks, pitches_mm = list[FloatArray](), list[float]()
    for found, (named, rows, stack) in zip(known.pairs, read_passages(sources, scanner, on_progress), strict=True):
        pitches_mm.append(rows.scanner.row_pitch_mm or 0.0)
        due = (1, len(stacks[0]) if stacks else stack.shape[1])
        if stack.shape[:2] != due or pitches_mm[-1] != pitches_mm[0] or not pitches_mm[0]:
            shape = f"{stack.shape[:2]}, {pitches_mm[-1]:g} mm apart, and {due}, {pitches_mm[0]:g} mm apart, is due"
            needs = "a log has one view, and rows with a distance"
            raise refused("other-detector", f"{named} has (views, rows) = {shape}: {needs}")
        way = -1 if found.cell_order is CellOrder.COUNTER_CLOCKWISE else 1
        stacks.append(bridged(stack[0, :, ::way].astype(np.float64)))
    with input_errors_translated():
        pictures = log_pictures(stacks, scanner.pairs, [pair.source_frame for pair in known.pairs], pitches_mm[0])
    if aligned is not None:
        _write_aligned(pictures, aligned)
    errors = np.array([pair.predicted_rms_mm for pair in known.pairs])
    sights = Sights.of(pictures, errors, known.scale_uncertainty_percent / 100.0 / TWO_SIDED_95)
    bodies = sights.bodies()
    unplaced = sum(map(len, sights.marks)) - len({mark for body in bodies for mark in body.marks.items()})
    marks = [
        LocatedMark(
            place_mm=tuple(body.place_mm.tolist()),
            deviations_mm=tuple(body.deviations_mm.tolist()),
            pairs=(*sorted(pair + 1 for pair in body.marks),),
            residual_mm=body.residual_mm,
            is_ambiguous=body.is_ambiguous,
        )
        for body in bodies
    ]
    return LogOnPairs(marks=marks, unplaced=unplaced, agreement=agreement(sights, tolerance_mm))


def _write_aligned(pictures: LogPictures, path: Path) -> None:
    """Write the rows of all pairs as a scan, a view for each pair, and its geometry as JSON."""
    cell_mm, row_mm = (float(at[1] - at[0]) for at in (pictures.cells_mm, pictures.heights_mm))
    of_views = path, pictures.lines.shape
    angles_rad = pictures.views.angles_rad
    with new_scan(*of_views, angles_rad=angles_rad, detector_pitch_mm=cell_mm, row_pitch_mm=row_mm) as scan:
        scan.data[...] = pictures.lines
        scan.note(air_level=None, provenance={"made_by": "sawmill locate-marks"})
    path.with_suffix(".json").write_text(json.dumps(vectors_of(pictures.views)))
