"""The job that reads an upload into the one form that every later job uses."""

import math
from typing import Any

from sawmill_calibration.failures import memory_available, refused
from sawmill_calibration.scans.prepare import prepare_scan
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.row_ranges import parse_rows
from sawmill_contracts.scans import ScanReading, ScanShape
from sawmill_formats.input.angles import parse_angles
from sawmill_formats.input.arrays import MAX_BYTES
from sawmill_formats.input.reading import reading_scan
from sawmill_platform.attempts.protocol import Needs
from sawmill_vocabulary import DataKind, RowAlignment
from sawmill_worker.jobs.attempt import FILE_BYTES, FILE_SHARE, MillAttempt


def run(attempt: MillAttempt) -> dict[str, Any]:
    """Write scan.h5 and return the properties of the scan."""
    scan, constants = attempt.given.scan, attempt.scanner.constants
    assert scan is not None  # noqa: S101 - required by this kind of job
    attempt.report_stage(0.0, "read")
    with reading_scan(
        attempt.file,
        counts=scan.data is DataKind.COUNTS,
        dataset=scan.dataset,
        angles_deg=None if scan.angles_deg is None else parse_angles(scan.angles_deg),
        detector_pitch_mm=constants.detector_pitch_mm,
        row_pitch_mm=constants.row_pitch_mm,
        rows_missing=scan.align_rows is not RowAlignment.OFF,
        averaged_rows=scan.averaged_rows,
        transpose=scan.transpose,
        axes=scan.axes,
        free_bytes=memory_available(),
    ) as read:
        _, rows, detector = read.shape
        if detector != constants.num_detector_pixels:
            raise refused(
                "other-detector",
                f"the file has {detector} detector cells (of views, rows, cells = {read.shape}), but the scanner has "
                f"num_detector_pixels {constants.num_detector_pixels}",
            )
        if scan.phantom_rows is not None and parse_rows(scan.phantom_rows).stop > rows:
            raise refused("rows-outside", f"phantom_rows is {scan.phantom_rows}, but the file has rows 0:{rows} only")
        prepared = prepare_scan(
            read,
            scan,
            attempt.output / "scan.h5",
            detector_pitch_mm=constants.detector_pitch_mm,
            report=attempt.report,
            provenance={"format": read.format, "input_sha256": scan.sha256},
        )
    views, rows, detector = prepared.shape
    return ScanReading(
        format=read.format,
        shape=ScanShape(views=views, rows=rows, detector=detector),
        angular_range_deg=(math.degrees(read.angles_rad[0]), math.degrees(read.angles_rad[-1])),
        usable_rows=prepared.usable_rows,
        views_left_out=prepared.views_left_out,
        remarks=list(prepared.remarks),
        coded_remarks=[CodedReason.of(each) for each in prepared.remarks],
    ).model_dump(mode="json")


def needs(_: MillAttempt) -> Needs:
    """Return no needs beyond the common limits: sizes that a file declares are not trusted before it is read."""
    return Needs(0, int(FILE_SHARE * MAX_BYTES) + FILE_BYTES)
