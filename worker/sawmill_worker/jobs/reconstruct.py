"""Reconstruct the slices of a scan."""

from typing import Any

from sawmill_worker.contracts.calibrations import CalibrationSucceeded
from sawmill_worker.contracts.geometry import Theta
from sawmill_worker.contracts.reconstructions import ReconstructionAsked
from sawmill_worker.files.scan_reader import open_scan
from sawmill_worker.jobs.attempt import Attempt
from sawmill_worker.jobs.calibrate import usable_scan
from sawmill_worker.storage.store import Store
from sawmill_worker.use_cases.failures import refused
from sawmill_worker.use_cases.reconstruct import ReconstructionInput, run_reconstruction
from sawmill_worker.use_cases.selection import chosen_rows, chosen_views
from sawmill_worker.vocabulary import DataKind, Handedness, Rotation


def reconstruct(attempt: Attempt) -> dict[str, Any]:
    """Write volume.h5 and answer with what it holds."""
    store = attempt.store
    asked = store.reconstructions.get(attempt.job.subject_id)
    options = asked.options
    scan = usable_scan(store, asked.scan_id)
    assert scan.shape is not None  # noqa: S101 - usable_scan saw to it
    rows = range(scan.shape.rows)[chosen_rows(options.rows, scan.shape.rows)]
    views = chosen_views(options.views, scan.shape.views)
    theta, rotation, handedness = geometry_of(store, options)
    constants = store.scanners.get(asked.scanner_id).constants
    with open_scan(store.files.scan(scan.id)) as stored:
        given = ReconstructionInput(
            read=lambda start, stop: stored.rows(rows[start:stop], views),
            angles_rad=stored.angles_rad[views],
            rows=(rows.start, rows.stop),
            row_step=rows.step,
            scanner=constants.model_copy(update={"row_pitch_mm": stored.row_pitch_mm}),
            theta=theta,
            rotation=rotation,
            handedness=handedness,
            input_sha256=scan.sha256,
            counts=scan.data is DataKind.COUNTS,
            preparation=tuple(scan.remarks),
        )
        result = run_reconstruction(given, options, attempt.output / "volume.h5", attempt.report)
    return result.model_dump(mode="json")


def geometry_of(store: Store, options: ReconstructionAsked) -> tuple[Theta, Rotation, Handedness]:
    """The theta that was given, or the calibration's; refused where it has none."""
    if options.theta is not None:
        return options.theta, options.rotation or Rotation.AS_GIVEN, options.handedness or Handedness.AS_DRAWN
    if options.calibration_id is None:
        raise refused("no-active-calibration", "neither calibration_id nor theta names a geometry")
    calibration = store.calibrations.get(options.calibration_id)
    if not isinstance(calibration, CalibrationSucceeded):
        raise refused(
            "calibration-without-result",
            f"calibration {options.calibration_id!r} is {calibration.state} and has no geometry to use",
        )
    return calibration.theta, calibration.rotation, calibration.handedness
