"""Example resources in a new data folder, so that the console's "Try it out" works at once.

Their scans are files that `docs/tools/example_files.py` has simulated, so that the service need not load the science.
"""

import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import structlog

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.inspections import InspectionOptions
from sawmill_contracts.kinds import Ask
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.plans import PlanRequest
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.contracts.jobs import Priority
from sawmill_platform.contracts.uploads import UploadRequest
from sawmill_platform.errors import Conflict
from sawmill_platform.files.file_store import EXAMPLES
from sawmill_platform.uploads.upload_store import UploadQuota
from sawmill_store.examples import EXAMPLE, LOG_FILES, PAIR_FILES, SCANNER_NAMES, SPARE, SPARSE
from sawmill_store.requests.asked import NOTHING, Asked
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind, Polygon, ReconstructionMethod, Theta

RECORDED = Path(__file__).parent / "example_files"
STACK_FILE, PHANTOM_FILE = "log-with-phantom.h5", "phantom-scan.npz"
# The files of an example of fixed pairs, of a board and of a log, by the ids of their inspections.
RECORDED_PAIRS, RECORDED_LOG = (
    {identifier: f"{name}-{number}.h5" for number, identifier in enumerate(files, 1)}
    for name, files in (("pairs", PAIR_FILES), ("log", LOG_FILES))
)
# Marks a data folder whose examples are made.
DONE = "complete"
L_SHAPE = "l-shape"
# The published scanner (arXiv 2206.14444) with another geometry.
ROW_PITCH_MM = 4.0
CONSTANTS = ScannerConstants(
    source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.502864583, row_pitch_mm=ROW_PITCH_MM
)
THETA = Theta(
    initial_angle_rad=1.1, detector_to_cor_mm=741.0, source_shift_mm=212.0, detector_shift_mm=31.0, detector_tilt=0.17
)
PHANTOM_ROWS, LOG_ROWS = 3, 5


def seed_examples(store: Store) -> None:
    """Queue and store the examples once in the life of a data folder; safe to repeat after an interruption.

    Examples are computed in the background, so that jobs of users do not wait for examples.
    """
    folder = store.files.folder / EXAMPLES
    if (folder / DONE).exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(RECORDED / PHANTOM_FILE, folder / PHANTOM_FILE)
    for identifier in {EXAMPLE, SPARE} - {item.id for item in store.scanners.page().items}:
        store.scanners.create(ScannerSpec(name=SCANNER_NAMES[identifier], constants=CONSTANTS), scanner_id=identifier)
    if SPARE not in {item.id for item in store.phantoms.page().items}:
        cross = [(-100, -30), (-30, -30), (-30, -120), (40, -120), (40, -30), (100, -30), (100, 30), (-100, 30)]
        tee = Polygon(vertices_mm=tuple((float(x), float(y)) for x, y in cross))
        store.phantoms.create(PhantomDrawing(name="example tee", shapes=[tee]), phantom_id=SPARE)
    existing = {item.id for item in store.scans.page().items}
    for identifier in (each for each in (SPARE, EXAMPLE) if each not in existing):
        spec = ScanSpec(
            scanner_id=EXAMPLE,
            data=DataKind.COUNTS,
            name="example: a log with the L-shaped phantom on its end",
            phantom_id=L_SHAPE,
            phantom_rows=f"0:{PHANTOM_ROWS}",
        )
        received = store.files.receive([(RECORDED / STACK_FILE).read_bytes()], max_bytes=2**30)
        store.scans.accept(spec, received, scan_id=identifier, priority=Priority.BACKGROUND)
    inspected = {SPARE: PHANTOM_FILE, EXAMPLE: PHANTOM_FILE, **RECORDED_PAIRS, **RECORDED_LOG}
    for identifier in inspected.keys() - {item.id for item in store.inspections.page().items}:
        name = inspected[identifier]
        received = store.files.receive([(RECORDED / name).read_bytes()], max_bytes=2**30)
        store.inspections.accept_file(
            InspectionOptions(), received, name=name, identifier=identifier, priority=Priority.BACKGROUND
        )
    for identifier in (EXAMPLE, SPARE):
        with suppress(Conflict):  # the upload waits already
            store.uploads.create(UploadRequest(size_bytes=2**20), UploadQuota(2, 2**21, 2**30), identifier=identifier)
    _ask_once(store.calibrations, CalibrationRequest(scan_id=EXAMPLE, activate=True), job_id=EXAMPLE)
    log = ReconstructionRequest(
        scan_id=EXAMPLE, calibration_id=EXAMPLE, rows=f"{PHANTOM_ROWS}:{PHANTOM_ROWS + LOG_ROWS}"
    )
    sparse = ReconstructionRequest(
        scan_id=EXAMPLE,
        calibration_id=EXAMPLE,
        rows=f"{PHANTOM_ROWS}:{PHANTOM_ROWS + 1}",
        views=20,
        method=ReconstructionMethod.TIKHONOV,
        size=128,
    )
    _ask_once(store.reconstructions, log)
    _ask_once(store.reconstructions, sparse, SPARSE)
    _ask_once(store.drifts, DriftRequest(scan_id=EXAMPLE, calibration_id=EXAMPLE))
    _ask_once(store.plans, PlanRequest(scanner_id=EXAMPLE, theta=THETA, views=20), given={"phantom_id": L_SHAPE})
    # Any other kind is requested with the request body of the console's example.
    for declared in filter(lambda kind: kind.upload is None, asked_kinds()):
        given = dict(declared.to_ask.example)
        example_id = str(declared.to_get.example.get(declared.id_name, "example"))
        _ask_once(store.asked(declared), declared.ask.model_validate(given.pop("body")), example_id, given=given)
    for identifier in {EXAMPLE, SPARE} - {item.id for item in store.schedules.page().items}:
        store.schedules.create(
            ScheduleSpec(scanner_id=EXAMPLE, cron="30 5 * * 1-6", enabled=False), schedule_id=identifier
        )
    (folder / DONE).touch()
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
