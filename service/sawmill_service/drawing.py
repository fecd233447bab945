"""Results of jobs, and pictures that are drawn on their first request: reports, which need matplotlib, and thumbnails.

Drawing modules are imported by the first picture: no other request needs them.
"""
# ruff: noqa: PLC0415 - for that reason

import hashlib
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.fixed_pairs import FixedPairsResult
from sawmill_contracts.reconstructions import ReconstructionResult
from sawmill_contracts.scans import Scan, ScanShape
from sawmill_formats.errors import damage_reported
from sawmill_mill.next_step import NextStep
from sawmill_platform.errors import if_found
from sawmill_service.http.problems import Refused
from sawmill_store.calibrations import Reconstructions
from sawmill_store.mill_files import MillFiles
from sawmill_store.scans.scans import Scans
from sawmill_vocabulary.messages import Reader

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sawmill_vocabulary.calibration_arrays import CalibrationArrays


# One picture at a time: a picture that many request at once is drawn once, and threads share matplotlib's caches.
DRAWING = threading.Lock()
# Thumbnails need no matplotlib, and do not wait for a report.
_SMALL = threading.Lock()
THUMBNAIL = "thumbnail.png"
# Peaks of the memory of drawing, all copies included (tests/service/test_memory_budget.py): for each value that is
# read, or pixel of a mosaic's tiles, and for a picture of matplotlib.
BYTES_PER_VALUE, FIGURE_BYTES = 15, 64 * 2**20


class CalibrationPicture(StrEnum):
    """Pictures of a calibration, by the names of their files."""

    OVERLAY = "overlay.png"
    LOG_BEFORE = "log-before.png"
    LOG_AFTER = "log-after.png"


# Names in result.h5; both pictures of a log have the grey window of the second, so that they can be compared.
_LOGS = {CalibrationPicture.LOG_BEFORE: "log_before", CalibrationPicture.LOG_AFTER: "log_after"}


def calibration_picture(files: MillFiles, calibration_id: str, picture: CalibrationPicture) -> Path:
    """Return the path of a calibration's picture; draw it from result.h5 and keep it if it is missing."""
    path = files.result(kinds.CALIBRATE, calibration_id, "result.h5")

    def draw() -> bytes:
        if picture in _LOGS:
            return _log_png(path, calibration_id, _LOGS[picture])
        from sawmill_calibration.pictures.calibration_report import overlay_png

        return overlay_png(_answer(path)[1])

    return files.kept(kinds.CALIBRATE, calibration_id, picture, draw, one_at_a_time=DRAWING)


def report_picture(files: MillFiles, calibration_id: str, step: NextStep, reader: Reader) -> Path:
    """Return the path of a calibration's report with its next step; drawn and kept for each step and language."""
    path = files.result(kinds.CALIBRATE, calibration_id, "result.h5")

    def draw() -> bytes:
        from sawmill_calibration.pictures.calibration_report import report_png

        return report_png(*_answer(path), step, reader)

    of_step = hashlib.sha256(f"{step.tone} {step.reason}".encode()).hexdigest()[:12]
    name = f"report-{reader.language}-{of_step}.png"
    return files.kept(kinds.CALIBRATE, calibration_id, name, draw, one_at_a_time=DRAWING)


@dataclass(frozen=True)
class ShownLog:
    """A log next to the phantom, as a calibration's pictures show the log.

    `before` names the geometry of `log-before.png`, None where there is no such picture; `row` is the shown row of the
    scan.
    """

    row: int
    before: str | None


def shown_log(files: MillFiles, calibration_id: str) -> ShownLog | None:
    """Describe the log that a calibration's pictures show; None where the scan shows no log, or its files are gone."""
    from sawmill_formats.output.calibration_file import read_arrays
    from sawmill_vocabulary.calibration_arrays import log_before_with

    path = if_found(files.result, kinds.CALIBRATE, calibration_id, "result.h5")
    if path is None:
        return None
    arrays = read_arrays(path, "log_row", "log_before", "log_before_with")
    if "log_row" not in arrays:
        return None
    with damage_reported(path.name):
        return ShownLog(int(arrays["log_row"]), log_before_with(arrays).value if "log_before" in arrays else None)


def _answer(path: Path) -> "tuple[CalibrationResult, CalibrationArrays]":
    from sawmill_formats.output import calibration_file
    from sawmill_vocabulary.calibration_arrays import CalibrationArrays

    record = calibration_file.read_calibration(path)
    with damage_reported(path.name):
        return CalibrationResult.model_validate(record.answer), CalibrationArrays.of(record.arrays)


def _log_png(path: Path, calibration_id: str, name: str) -> bytes:
    from sawmill_calibration.pictures.images import bare_png
    from sawmill_calibration.pictures.pages import LOG_WINDOW, window_of
    from sawmill_formats.output.calibration_file import read_arrays

    arrays = read_arrays(path, "log_field_mm", "log_after", name)
    if name not in arrays:
        raise Refused(404, "no-log", f"the scan of calibration {calibration_id!r} gives no {name}: it shows no log")
    window = window_of(arrays["log_after"], *LOG_WINDOW)
    return bare_png(arrays[name], field_mm=float(arrays["log_field_mm"]), window=window)


def drawn_alpha_curve(columns: "Mapping[str, NDArray[Any]]") -> bytes:
    """Draw the curve from which Tikhonov's alpha was chosen, as PNG."""
    from sawmill_calibration.pictures.figures import alpha_curve_png

    with DRAWING:
        return alpha_curve_png(**columns)


def drawn_ring(result: FixedPairsResult, reader: Reader) -> bytes:
    """Draw the pairs of a calibrated scanner of fixed pairs, as PNG."""
    from sawmill_calibration.pictures.ring_of_pairs import ring_png

    with DRAWING:
        return ring_png(result, reader)


def scan_thumbnail(files: MillFiles, scan: Scan, shape: ScanShape) -> Path:
    """Return the path of a scan's thumbnail, the sinogram of the middle row; draw and keep it if it is missing."""

    def draw() -> bytes:
        from sawmill_calibration.pictures.images import thumbnail_png
        from sawmill_formats.output import scan_reader

        path, row = files.scan(scan.id), middle_row(scan, shape)
        return thumbnail_png(scan_reader.sinogram(path, shape.lengths, row).data)

    return files.kept(kinds.INGEST, scan.id, THUMBNAIL, draw, one_at_a_time=_SMALL)


def volume_thumbnail(files: MillFiles, reconstruction_id: str, result: ReconstructionResult) -> Path:
    """Return the path of a volume's thumbnail, the middle slice; draw and keep it as `scan_thumbnail` does."""

    def draw() -> bytes:
        from sawmill_calibration.pictures.images import thumbnail_png
        from sawmill_formats.output import volume_reader

        middle = volume_reader.volume_slice(files.volume(reconstruction_id), result.shape, result.shape[0] // 2)
        return thumbnail_png(middle.data, result.value_range)

    return files.kept(kinds.RECONSTRUCT, reconstruction_id, THUMBNAIL, draw, one_at_a_time=_SMALL)


def result_of(reconstructions: Reconstructions, reconstruction_id: str) -> ReconstructionResult:
    """Return the result of a reconstruction."""
    reconstruction = reconstructions.get(reconstruction_id)
    if reconstruction.result is None:
        raise Refused(
            409,
            "reconstruction-without-result",
            f"reconstruction {reconstruction_id!r} is {reconstruction.state} and has no volume",
        )
    return reconstruction.result


def check_slice(result: ReconstructionResult, index: int) -> None:
    """Refuse the index of a slice that a volume does not have."""
    slices = result.shape[0]
    if index >= slices:
        raise Refused(404, "slice-not-found", f"index must be below {slices}, the slices, not {index}")


def ready_scan(scans: Scans, scan_id: str) -> tuple[Scan, ScanShape]:
    """Return a scan that has been read, and its shape."""
    scan = scans.get(scan_id)
    if scan.shape is None:
        reason = scan.reason or f"job {scan.job_id} still reads it"
        raise Refused(409, f"scan-{scan.state}", f"scan {scan_id!r} is {scan.state}: {reason}")
    return scan, scan.shape


def middle_row(scan: Scan, shape: ScanShape) -> int:
    """Return the middle of the rows that enough views have."""
    first, last = scan.usable_rows or (0, shape.rows)
    return (first + last) // 2
