"""The job that reconstructs the slices of a scan."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numba import get_num_threads

from sawmill_calibration.failures import refused
from sawmill_calibration.known_geometry import GivenGeometry, KnownGeometry
from sawmill_calibration.reconstruction.block_solvers import MOST_FITTED_IMAGES, MOST_TOGETHER, may_fit
from sawmill_calibration.reconstruction.reconstruct import MEMORY_SHARE, run_reconstruction
from sawmill_calibration.scans.scan_rows import ScanRows, chosen_rows
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.reconstructions import Reconstruction, StoredReconstructionOptions
from sawmill_contracts.scans import ScanShape
from sawmill_formats.output.scan_reader import open_scan
from sawmill_platform.attempts.protocol import Needs
from sawmill_tomography.geometry.geometry import FanBeamGeometry
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import BLOCK, LARGEST_SIZE
from sawmill_tomography.reconstruction import cost
from sawmill_tomography.reconstruction.iterative.coarse_outside import WORTH_WHILE, fitted_size
from sawmill_tomography.reconstruction.object_extent import seen_radius_mm
from sawmill_tomography.warm_up import load_iterative_methods
from sawmill_vocabulary import Handedness, Rotation
from sawmill_worker.jobs.attempt import FILE_BYTES, FILE_SHARE, PROCESS_BYTES, MillAttempt
from sawmill_worker.jobs.calibrate import shape_of, stored_rows, usable_calibration, usable_scan
from sawmill_worker.jobs.checkpoints import AttemptKeeper

# Arrays in single precision for each slice of a fitted method: the data, residuals and trial steps.
LINES_A_SLICE = 40


def run(attempt: MillAttempt) -> dict[str, Any]:
    """Write volume.h5 and return the result."""
    options = attempt.asked(Reconstruction).options
    with open_scan(attempt.file) as stored:
        rows = stored_rows(attempt, stored, options.rows, options.views)
        rows = replace(rows, scanner=replace(rows.scanner, row_pitch_mm=stored.row_pitch_mm))
        geometry = _geometry_of(attempt, options, rows.scanner)
        keeper = _keeper(attempt, rows, geometry, options)
        result = run_reconstruction(rows, geometry, options, attempt.output / "volume.h5", attempt.report, keeper)
    return result.model_dump(mode="json")


def _keeper(
    attempt: MillAttempt, scan: ScanRows, geometry: KnownGeometry, options: StoredReconstructionOptions
) -> AttemptKeeper:
    origin = {
        **{name: getattr(scan, name) for name in ("rows", "row_step", "counts", "sha256", "remarks")},
        "views": len(scan.angles_rad),
        "scanners": [asdict(scan.scanner), asdict(geometry.scanner)],
        "geometry": [asdict(geometry.theta), geometry.rotation, geometry.handedness],
        "beam": asdict(geometry.beam),
        "options": options.model_dump(mode="json"),
    }
    slices = len(range(*scan.rows, scan.row_step))
    return AttemptKeeper(attempt, origin, still_to_write_bytes=cost.volume_bytes(options.size, slices))


def make_ready(attempt: MillAttempt) -> None:
    """Compile the uncached kernels of a fitted method: the attempt could not write to the kernel cache later."""
    if may_fit(attempt.asked(Reconstruction).options.method):
        attempt.report_stage(0.0, "prepare")
        load_iterative_methods()


def needs(attempt: MillAttempt) -> Needs:
    """Compute the needs of rows reconstructed together, images fitted together, and the volume."""
    options, scan = attempt.asked(Reconstruction).options, usable_scan(attempt)
    shape = shape_of(scan)
    slices = len(range(shape.rows)[chosen_rows(options.rows, shape.rows, scan.usable_rows)])
    file_bytes = int(FILE_SHARE * cost.volume_bytes(options.size, slices)) + FILE_BYTES
    at_work = max(
        cost.MEMORY_BYTES,
        cost.block_bytes(shape.views, shape.detector, options.size, 1),
        _fitting(attempt, options, shape) if may_fit(options.method) else 0,
    )
    return Needs(PROCESS_BYTES + int(at_work / MEMORY_SHARE), file_bytes)


def _fitting(attempt: MillAttempt, options: StoredReconstructionOptions, shape: ScanShape) -> int:
    """Compute the need of the method that needs most, on a grid that holds all that the detector can see."""
    constants = attempt.scanner.constants
    geometry = FanBeamGeometry(constants, _geometry_of(attempt, options, constants).theta, np.zeros(1))
    field, radius_mm = ImageGrid(options.size, options.field_mm, options.field_centre_mm), seen_radius_mm(geometry)
    # A larger grid is refused. A log smaller than the field of view may have one grid instead of two.
    size = min(field.around(radius_mm)[0].size, LARGEST_SIZE)
    pixels = min(size**2, round(fitted_size(field, radius_mm) ** 2 / WORTH_WHILE))
    images = MOST_FITTED_IMAGES + get_num_threads() * BLOCK
    return 4 * (images * pixels + LINES_A_SLICE * MOST_TOGETHER * shape.views * shape.detector)


def _geometry_of(
    attempt: MillAttempt, options: StoredReconstructionOptions, scanner: ScannerConstants
) -> KnownGeometry:
    """Return the given theta of the scanner, or the calibration; refuse a calibration without theta."""
    if options.theta is not None:
        rotation, handedness = options.rotation or Rotation.AS_GIVEN, options.handedness or Handedness.AS_DRAWN
        return GivenGeometry(scanner, options.theta, rotation, handedness)
    if attempt.given.calibration is None:
        raise refused("no-active-calibration", "no calibration of the scanner was activated")
    return usable_calibration(attempt, "use")
