"""What a job may need of memory and disk, from the sizes recorded when its scan was read and what was asked of it.

Upper bounds with room to spare, for limits that an ordinary job never meets. What an unread file declares counts for
nothing: the jobs that read one have no needs beyond the limits that all have.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numba import get_num_threads

from sawmill_worker.contracts.jobs import JobKind
from sawmill_worker.contracts.reconstructions import ReconstructionAsked
from sawmill_worker.contracts.scans import ScanShape
from sawmill_worker.jobs.attempt import Attempt
from sawmill_worker.jobs.calibrate import usable_scan
from sawmill_worker.jobs.plan import planned_with
from sawmill_worker.jobs.reconstruct import geometry_of
from sawmill_worker.readers.arrays import MAX_BYTES
from sawmill_worker.tomography import cost
from sawmill_worker.tomography.geometry import FanBeamGeometry
from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.object_extent import seen_radius_mm
from sawmill_worker.tomography.projector import BLOCK, LARGEST_SIZE
from sawmill_worker.use_cases.conversion import to_scanner, to_theta
from sawmill_worker.use_cases.failures import input_errors_translated
from sawmill_worker.use_cases.reconstruct import MEMORY_SHARE
from sawmill_worker.use_cases.selection import chosen_rows
from sawmill_worker.use_cases.solving import IMAGES_A_DESCENT, IMAGES_OF_A_BASIS, ITERATED_TOGETHER, TRIALS
from sawmill_worker.vocabulary import ReconstructionMethod

# A process that has loaded everything: 0.34 GB were measured on two cores, 0.39 GB on eight.
PROCESS_BYTES = 2**29
# Sinograms, in double precision, that a calibration, a plan or a drift check keeps: 26 were measured.
SINOGRAMS = 100
# Of each slice that iterates, in single precision: the data, residuals and trial steps.
LINES_A_SLICE = 40
# A file that does not grow with the job, and what HDF5 adds to one that does.
FILE_BYTES, FILE_SHARE = 2**30, 1.05


class Needs(NamedTuple):
    """Bytes of private memory, and of the largest file."""

    memory_bytes: int
    file_bytes: int


def needs_of(attempt: Attempt) -> Needs:
    """What the job may need.

    Raises
    ------
    sawmill_worker.use_cases.failures.JobFailure
        What it is about cannot be used.
    """
    with input_errors_translated():
        return _NEEDS[attempt.job.kind](attempt)


def _ingest(_: Attempt) -> Needs:
    return Needs(0, int(FILE_SHARE * MAX_BYTES) + FILE_BYTES)


def _trace(_: Attempt) -> Needs:
    return Needs(0, 0)


def _calibrate(attempt: Attempt) -> Needs:
    asked = attempt.store.calibrations.get(attempt.job.subject_id)
    scan = usable_scan(attempt.store, asked.scan_id)
    shape = _shape(scan.shape)
    return _of_averaged_rows(shape, asked.options.rows or scan.phantom_rows)


def _drift(attempt: Attempt) -> Needs:
    asked = attempt.store.drifts.get(attempt.job.subject_id)
    return _of_averaged_rows(_shape(usable_scan(attempt.store, asked.scan_id).shape), asked.options.rows)


def _of_averaged_rows(shape: ScanShape, rows: str | None) -> Needs:
    """All rows are read at once, may be copied, and are looked at in double precision at some views."""
    wanted = chosen_rows(rows, shape.rows)
    stack = 4 * shape.views * (wanted.stop - wanted.start) * shape.detector
    sinograms = SINOGRAMS * 8 * shape.views * shape.detector
    return Needs(PROCESS_BYTES + 4 * stack + sinograms, FILE_BYTES + sinograms)


def _plan(attempt: Attempt) -> Needs:
    asked = attempt.store.plans.get(attempt.job.subject_id)
    scanner, _ = planned_with(attempt.store, asked)
    cells = scanner.constants.num_detector_pixels
    return Needs(PROCESS_BYTES + SINOGRAMS * 8 * asked.options.views * cells, 0)


def _reconstruct(attempt: Attempt) -> Needs:
    asked = attempt.store.reconstructions.get(attempt.job.subject_id)
    options, scan = asked.options, usable_scan(attempt.store, asked.scan_id)
    shape = _shape(scan.shape)
    slices = len(range(shape.rows)[chosen_rows(options.rows, shape.rows)])
    volumes = 2 if options.uncertainty else 1
    file_bytes = int(FILE_SHARE * volumes * cost.volume_bytes(options.size, slices)) + FILE_BYTES
    at_work = max(
        cost.MEMORY_BYTES,
        cost.block_bytes(shape.views, shape.detector, options.size, 1),
        0 if options.method is ReconstructionMethod.FBP else _iterating(attempt, options, asked.scanner_id, shape),
    )
    return Needs(PROCESS_BYTES + int(at_work / MEMORY_SHARE), file_bytes)


def _iterating(attempt: Attempt, options: ReconstructionAsked, scanner_id: str, shape: ScanShape) -> int:
    """By the method that takes most, on a grid that holds all that the detector can see."""
    constants = attempt.store.scanners.get(scanner_id).constants
    theta, _, _ = geometry_of(attempt.store, options)
    geometry = FanBeamGeometry(to_scanner(constants), to_theta(theta), np.zeros(1))
    grid, _ = ImageGrid(options.size, options.field_mm, options.field_centre_mm).around(seen_radius_mm(geometry))
    # A larger grid is refused.
    pixels = min(grid.size, LARGEST_SIZE) ** 2
    images = max(IMAGES_OF_A_BASIS, IMAGES_A_DESCENT * max(TRIALS, ITERATED_TOGETHER))
    images += get_num_threads() * BLOCK
    lines = LINES_A_SLICE * ITERATED_TOGETHER * shape.views * shape.detector
    return 4 * (images * pixels + lines)


def _shape(shape: ScanShape | None) -> ScanShape:
    assert shape is not None  # noqa: S101 - usable_scan saw to it
    return shape


_NEEDS: Mapping[JobKind, Callable[[Attempt], Needs]] = MappingProxyType(
    {
        JobKind.INGEST: _ingest,
        JobKind.TRACE_PHANTOM: _trace,
        JobKind.CALIBRATE: _calibrate,
        JobKind.RECONSTRUCT: _reconstruct,
        JobKind.PLAN: _plan,
        JobKind.DRIFT: _drift,
    }
)
