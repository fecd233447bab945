"""Reconstruct the slices of a scan."""

from typing import Any

from worker.contracts.base import DataKind, Handedness, Rotation
from worker.contracts.calibrations import CalibrationSucceeded
from worker.contracts.geometry import Theta
from worker.contracts.reconstructions import ReconstructionAsk, ReconstructionOptions
from worker.formats.scan_file import read_stored_scan
from worker.storage.store import Store
from worker.tasks.attempt import Attempt
from worker.tasks.calibrate import usable_scan
from worker.tasks.failures import refused
from worker.tasks.reconstructing import ReconstructionInput, run_reconstruction, volume_unit
from worker.tasks.selection import chosen_rows, chosen_views
from worker.tasks.writing_volumes import write_volume


def reconstruct(attempt: Attempt) -> dict[str, Any]:
    """Write volume.h5 and answer with what it holds."""
    store = attempt.store
    asked = store.reconstructions.get(attempt.job.subject_id)
    options = asked.options
    scan = usable_scan(store, asked.scan_id)
    assert scan.shape is not None  # noqa: S101 - usable_scan saw to it
    rows, views = chosen_rows(options.rows, scan.shape.rows), chosen_views(options.views, scan.shape.views)
    stored = read_stored_scan(store.files.scan(scan.id), rows, views)
    theta, rotation, handedness = _geometry(store, options)
    constants = store.scanners.get(asked.scanner_id).constants
    constants = constants.model_copy(update={"row_pitch_mm": stored.row_pitch_mm})
    given = ReconstructionInput(
        line_integrals=stored.line_integrals,
        angles_rad=stored.angles_rad,
        rows=(rows.start, rows.stop),
        scanner=constants,
        theta=theta,
        rotation=rotation,
        handedness=handedness,
        input_sha256=scan.sha256,
        unit=volume_unit(counts=scan.data is DataKind.COUNTS),
    )
    volume, result = run_reconstruction(given, options, attempt.report)
    only_options = ReconstructionOptions.model_validate(
        options.model_dump(include=set(ReconstructionOptions.model_fields))
    )
    write_volume(attempt.output / "volume.h5", volume, result, only_options, constants)
    return result.model_dump(mode="json")


def _geometry(store: Store, options: ReconstructionAsk) -> tuple[Theta, Rotation, Handedness]:
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
