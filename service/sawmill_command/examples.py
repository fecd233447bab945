"""Example resources in a new data folder, so that the console's "Try it out" works at once.

`python -m sawmill_command.examples` makes the examples in the store of its environment, and ends with its standard
input.
"""

import io
import os
import sys
import threading
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import numpy as np
import structlog

from sawmill_calibration.simulation import write_simulated_scan
from sawmill_command.seeding import examples_made
from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_contracts.drifts import DriftAsk
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.inspections import InspectionOptions
from sawmill_contracts.kinds import Ask
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.plans import PlanAsk
from sawmill_contracts.reconstructions import ReconstructionAsk
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.contracts.jobs import Priority
from sawmill_platform.contracts.uploads import UploadAsk
from sawmill_platform.errors import Conflict
from sawmill_platform.settings import StorageSettings
from sawmill_platform.uploads.upload_store import UploadQuota, Uploads
from sawmill_platform.workers.logs import configure_logs
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_store.examples import EXAMPLE, SCANNER_NAMES, SPARE, SPARSE
from sawmill_store.inspections import Inspections
from sawmill_store.requests.asked import NOTHING, Asked
from sawmill_store.scans import Scans
from sawmill_store.store import Store
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, Scanner, Theta
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.simulate import SimulatedStack, simulate_stack
from sawmill_vocabulary import DataKind, Polygon, ReconstructionMethod
from sawmill_vocabulary.physics import BeamEffects, DetectorEffects, MotionEffects, Physics, WoodEffects

SEED = 2206
# The published scanner (arXiv 2206.14444) with another geometry.
SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.502864583)
THETA = Theta(
    initial_angle_rad=1.1, detector_to_cor_mm=741.0, source_shift_mm=212.0, detector_shift_mm=31.0, detector_tilt=0.17
)
ROW_PITCH_MM = 4.0
PHANTOM_ROWS, LOG_ROWS = 3, 5
LOG_START_MM = 192.0
# Density of a dry board.
DRY_WOOD_PER_MM = 0.009
# A bad day at the mill; examples/bad-day.json holds the same values.
BAD_DAY = Physics(
    BeamEffects(energy_spread=0.2, scatter_share=0.02),
    DetectorEffects(blur_mm=0.8, lag_share=0.01, slope_share=0.01, gain_spread=0.03, dead_cells=2),
    MotionEffects(wobble_twice_mm=0.2, wobble_towards_deg=20.0, encoder_deg=0.05),
    WoodEffects(plane_tilt_deg=2.0, corner_radius_mm=3.0, knots=2),
)


def full_turn(views: int) -> FloatArray:
    """Return equidistant angles (views,) over a full turn, rad, starting at half a step."""
    angles: FloatArray = (np.arange(views) + 0.5) * 2.0 * np.pi / views
    return angles


def mill_log() -> LogModel:
    """Return the log of the example stack."""
    return LogModel.random(SEED)


def mill_slices(*, log_rows: int = LOG_ROWS, row_pitch_mm: float = ROW_PITCH_MM) -> list[Phantom]:
    """Return a log with the L-shaped phantom on its sawn end: phantom rows, then log rows."""
    wood = L_SHAPE.of_density(SAPWOOD_PER_MM).moved(3.0, -2.0)
    log = mill_log()
    return [wood] * PHANTOM_ROWS + [log.slice_at(LOG_START_MM + row * row_pitch_mm) for row in range(log_rows)]


def mill_stack(views: int, slices: list[Phantom]) -> SimulatedStack:
    """Simulate raw counts of the example scanner."""
    return simulate_stack(slices, FanBeamGeometry(SCANNER, THETA, full_turn(views)), seed=SEED)


def write_mill_stack(path: Path, views: int, slices: list[Phantom]) -> None:
    """Write raw counts of the example scanner as an NXtomo file."""
    _write_stack(path, views, mill_stack(views, slices))


def write_bad_day(path: Path, views: int) -> None:
    """Write a row of the L-shaped phantom on a bad day at the mill, as an NXtomo file."""
    wood = L_SHAPE.of_density(DRY_WOOD_PER_MM).moved(3.0, -2.0)
    geometry = FanBeamGeometry(SCANNER, THETA, full_turn(views))
    _write_stack(path, views, simulate_stack([wood], geometry, BAD_DAY, seed=SEED))


def _write_stack(path: Path, views: int, stack: SimulatedStack) -> None:
    write_simulated_scan(
        path, stack, full_turn(views), detector_pitch_mm=SCANNER.detector_pitch_mm, row_pitch_mm=ROW_PITCH_MM
    )


def seed_examples(store: Store) -> None:
    """Queue and store the examples once in the life of a data folder; safe to repeat after an interruption.

    Examples are computed in the background, so that jobs of users do not wait for examples.
    """
    done = examples_made(store.files)
    if done.exists():
        return
    folder = done.parent
    folder.mkdir(parents=True, exist_ok=True)
    stack = folder / "log-with-phantom.h5"
    write_mill_stack(stack, 120, mill_slices())
    _write_npz(folder / "phantom-scan.npz")
    existing = {item.id for item in store.scanners.page().items}
    for identifier in {EXAMPLE, SPARE} - existing:
        store.scanners.create(_scanner_spec(identifier), scanner_id=identifier)
    if SPARE not in {item.id for item in store.phantoms.page().items}:
        store.phantoms.create(_spare_phantom(), phantom_id=SPARE)
    _seed_scans(store.scans, stack)
    _seed_inspections(store.inspections, folder / "phantom-scan.npz")
    _seed_uploads(store.uploads)
    _ask_once(store.calibrations, CalibrationAsk(scan_id=EXAMPLE, activate=True), job_id=EXAMPLE)
    log = ReconstructionAsk(scan_id=EXAMPLE, calibration_id=EXAMPLE, rows=f"{PHANTOM_ROWS}:{PHANTOM_ROWS + LOG_ROWS}")
    sparse = ReconstructionAsk(
        scan_id=EXAMPLE,
        calibration_id=EXAMPLE,
        rows=f"{PHANTOM_ROWS}:{PHANTOM_ROWS + 1}",
        views=20,
        method=ReconstructionMethod.TIKHONOV,
        size=128,
    )
    _ask_once(store.reconstructions, log)
    _ask_once(store.reconstructions, sparse, SPARSE)
    _ask_once(store.drifts, DriftAsk(scan_id=EXAMPLE, calibration_id=EXAMPLE))
    plan = PlanAsk(scanner_id=EXAMPLE, theta=THETA, views=20)
    _ask_once(store.plans, plan, given={"phantom_id": L_SHAPE.name})
    # Any other kind is requested with the request body of the console's example.
    for declared in filter(lambda kind: kind.upload is None, asked_kinds()):
        given = dict(declared.to_ask.example)
        ask = declared.ask.model_validate(given.pop("body"))
        _ask_once(store.asked(declared), ask, declared.example_id, given=given)
    scheduled = {item.id for item in store.schedules.page().items}
    for identifier in {EXAMPLE, SPARE} - scheduled:
        store.schedules.create(
            ScheduleSpec(scanner_id=EXAMPLE, cron="30 5 * * 1-6", enabled=False), schedule_id=identifier
        )
    done.touch()
    structlog.get_logger().info("examples-ready", folder=str(folder))


def _ask_once(
    requests: Asked[Ask, Any],
    ask: Ask,
    identifier: str = EXAMPLE,
    *,
    job_id: str | None = None,
    given: Mapping[str, str] = NOTHING,
) -> None:
    """Request an example in the background, unless it was requested before."""
    if identifier not in {item.id for item in requests.page().items}:
        requests.accept(ask, identifier=identifier, job_id=job_id, priority=Priority.BACKGROUND, given=given)


def _scanner_spec(identifier: str) -> ScannerSpec:
    constants = ScannerConstants(
        source_to_cor_mm=SCANNER.source_to_cor_mm,
        num_detector_pixels=SCANNER.num_detector_pixels,
        detector_pitch_mm=SCANNER.detector_pitch_mm,
        row_pitch_mm=ROW_PITCH_MM,
    )
    return ScannerSpec(name=SCANNER_NAMES[identifier], constants=constants)


def _spare_phantom() -> PhantomDrawing:
    cross = [(-100, -30), (-30, -30), (-30, -120), (40, -120), (40, -30), (100, -30), (100, 30), (-100, 30)]
    return PhantomDrawing(
        name="example tee", shapes=[Polygon(vertices_mm=tuple((float(x), float(y)) for x, y in cross))]
    )


def _seed_scans(scans: Scans, stack: Path) -> None:
    existing = {item.id for item in scans.page().items}
    for identifier in (SPARE, EXAMPLE):
        if identifier not in existing:
            spec = ScanSpec(
                scanner_id=EXAMPLE,
                data=DataKind.COUNTS,
                name="example: a log with the L-shaped phantom on its end",
                phantom_id=L_SHAPE.name,
                phantom_rows=f"0:{PHANTOM_ROWS}",
            )
            received = scans.files.receive([stack.read_bytes()], max_bytes=2**30)
            scans.accept(spec, received, scan_id=identifier, priority=Priority.BACKGROUND)


def _seed_inspections(inspections: Inspections, file: Path) -> None:
    existing = {item.id for item in inspections.page().items}
    for identifier in {SPARE, EXAMPLE} - existing:
        received = inspections.files.receive([file.read_bytes()], max_bytes=2**30)
        inspections.accept_file(
            InspectionOptions(), received, name=file.name, identifier=identifier, priority=Priority.BACKGROUND
        )


def _seed_uploads(uploads: Uploads) -> None:
    """Declare two uploads that wait for their first part."""
    for identifier in (EXAMPLE, SPARE):
        with suppress(Conflict):  # the upload waits already
            uploads.create(UploadAsk(size_bytes=2**20), UploadQuota(2, 2**21, 2**30), identifier=identifier)


def _write_npz(path: Path) -> None:
    """Write a scan of only the phantom, small enough to be tried from a browser."""
    views = 60
    stack = mill_stack(views, mill_slices()[:1])
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        projections=stack.counts,
        flats=stack.flats,
        darks=stack.darks,
        angles_deg=np.rad2deg(full_turn(views)),
    )
    path.write_bytes(buffer.getvalue())


def _end_with_parent() -> None:
    # Not read through a file object: the interpreter needs its lock at the end, and would abort.
    while os.read(sys.stdin.fileno(), 1024):
        pass
    os._exit(1)


def main() -> None:
    """Make the examples, unless the requesting process ends."""
    configure_logs(ExecutionSettings().log_format)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with closing(Store(StorageSettings())) as store:
        seed_examples(store)


if __name__ == "__main__":
    main()
