"""A data folder of a mill whose scanners have been watched for weeks: what pages are shown and measured with.

Nothing in it is invented but the scans: every calibration, drift check and slice is computed from a simulated scan by
the job that a service would run, at a time of its own in the past. `write_history(store, clock)` takes about a second
for each scanner and day.
"""

import io
import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from sawmill_worker import examples
from sawmill_worker.contracts.calibrations import CalibrationAsk
from sawmill_worker.contracts.drifts import DriftAsk
from sawmill_worker.contracts.geometry import ScannerConstants
from sawmill_worker.contracts.reconstructions import ReconstructionAsk
from sawmill_worker.contracts.scanners import ScannerSpec
from sawmill_worker.contracts.scans import ScanSpec
from sawmill_worker.contracts.schedules import ScheduleSpec
from sawmill_worker.execution.handing_over import given_to
from sawmill_worker.files.scan_writer import write_raw_scan
from sawmill_worker.jobs.running import Attempt, run
from sawmill_worker.storage.store import Store
from sawmill_worker.tomography.built_in import L_SHAPE
from sawmill_worker.tomography.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_worker.tomography.log_model import LogModel
from sawmill_worker.tomography.phantom import Phantom
from sawmill_worker.tomography.simulate import simulate_stack
from sawmill_worker.vocabulary import DataKind

# Coarser cells than the example's scanner, and 120 views, the fewest that a drift check takes: a day costs a second.
SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=384, detector_pitch_mm=3.0)
VIEWS, ROW_PITCH_MM = 120, 4.0
PHANTOM_ROWS, LOG_ROWS, SHOWN_LOG_ROWS = 2, 1, 12
WEEK_DAYS = 7
SEED = 14
"""Simulated scans are those of this seed, of their scanner's number and of their day."""


@dataclass
class PastClock:
    """The store's clock, set by whoever writes the past."""

    now: datetime = field(default_factory=lambda: datetime.now(UTC))

    def __call__(self) -> datetime:
        """The time that rows are stamped with."""
        return self.now


@dataclass(frozen=True)
class Line:
    """A scanner and how its COR wanders on the detector: mm on a day, counted back from today (0)."""

    name: str
    moved_mm: Callable[[int], float]
    watched: bool = True


def _trembling(day: int) -> float:
    return 0.02 * math.sin(1.7 * day) + 0.015 * math.cos(0.9 * day)


LINES = (
    Line("Line 1", lambda day: 0.05 + _trembling(day)),
    Line("Line 2", lambda day: _trembling(day) + 0.0148 * max(0, 55 - day)),
    Line("Line 3", lambda day: _trembling(day) + (2.6 if day < 2 else 0.0)),
    Line("Line 4, new", lambda _: 0.0, watched=False),
)


def write_history(store: Store, clock: PastClock, *, lines: Sequence[Line] = LINES, days: int = 60) -> list[str]:
    """Scanners with a phantom scan a week, calibrated, and a log a day, checked for drift; their ids.

    The first calibration is the active one; today ends with a phantom scan of each line that is not in order, and
    with the slices of a longer log.
    """
    today, ids = clock.now, []
    clock.now = today - timedelta(days=days + 1)
    for number, line in enumerate(lines):
        ids.append(_scanner(store, line))
        log = LogModel.random(SEED + number)
        for day in range(days, -1, -1) if line.watched else ():
            clock.now = today - timedelta(days=day, hours=1, minutes=7 * number)
            _day(store, clock, _Scans(ids[-1], line, log, seed=1000 * number + day), day, first=day == days)
    clock.now = today
    return ids


@dataclass(frozen=True)
class _Scans:
    """What one line's scanner delivers on one day."""

    scanner_id: str
    line: Line
    log: LogModel
    seed: int

    def stack(self, day: int, *, phantom: bool, log_rows: int) -> bytes:
        """Counts as an NXtomo file: the phantom's rows, where it is on the log, then the log's."""
        bodies = [_phantom()] * (PHANTOM_ROWS if phantom else 0)
        bodies += [self.log.slice_at(examples.LOG_START_MM + row * ROW_PITCH_MM) for row in range(log_rows)]
        angles = examples.full_turn(VIEWS)
        stack = simulate_stack(
            bodies, FanBeamGeometry(SCANNER, theta_at(self.line.moved_mm(day)), angles), seed=SEED + self.seed
        )
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "scan.h5"
            write_raw_scan(
                path,
                counts=stack.counts,
                flats=stack.flats,
                darks=stack.darks,
                angles_rad=angles,
                detector_pitch_mm=SCANNER.detector_pitch_mm,
                row_pitch_mm=ROW_PITCH_MM,
            )
            return path.read_bytes()


def theta_at(moved_mm: float) -> Theta:
    """The example's geometry with its COR moved along the detector."""
    frame = examples.THETA.source_frame(SCANNER.source_to_cor_mm)
    return replace(frame, cor_column_mm=frame.cor_column_mm + moved_mm).theta(SCANNER.source_to_cor_mm)


def _phantom() -> Phantom:
    return L_SHAPE.of_density(examples.DRY_WOOD_PER_MM).moved(3.0, -2.0)


def _scanner(store: Store, line: Line) -> str:
    constants = ScannerConstants(**vars(SCANNER), row_pitch_mm=ROW_PITCH_MM)
    made = store.scanners.create(ScannerSpec(name=line.name, constants=constants, log_radius_mm=150.0))
    store.schedules.create(ScheduleSpec(scanner_id=made.id, cron="30 5 * * 1-6"))
    return made.id


def _day(store: Store, clock: PastClock, scans: _Scans, day: int, *, first: bool) -> None:
    troubled = abs(scans.line.moved_mm(day)) > 0.4
    if first or day % WEEK_DAYS == 0:
        rows = SHOWN_LOG_ROWS if day == 0 else LOG_ROWS
        scan_id = _uploaded(
            store, scans, scans.stack(day, phantom=True, log_rows=rows), f"phantom {clock.now:%Y-%m-%d}"
        )
        asked = store.calibrations.accept(CalibrationAsk(scan_id=scan_id))
        clock.now += timedelta(minutes=1)
        _run_next(store)
        if first:
            store.calibrations.activate(asked.id, "the first calibration")
        if day == 0 and not troubled:
            log_rows = f"{PHANTOM_ROWS}:{PHANTOM_ROWS + rows}"
            store.reconstructions.accept(ReconstructionAsk(scan_id=scan_id, rows=log_rows))
            _run_next(store)
        return
    scan_id = _uploaded(store, scans, scans.stack(day, phantom=False, log_rows=LOG_ROWS), f"log {clock.now.date()}")
    store.drifts.accept(DriftAsk(scan_id=scan_id))
    clock.now += timedelta(minutes=1)
    _run_next(store)


def _uploaded(store: Store, scans: _Scans, content: bytes, name: str) -> str:
    """An upload that has been read."""
    received = store.files.receive(io.BytesIO(content), max_bytes=2**30)
    phantom = "l-shape" if name.startswith("phantom") else None
    spec = ScanSpec(
        scanner_id=scans.scanner_id,
        name=name,
        data=DataKind.COUNTS,
        phantom_id=phantom,
        phantom_rows=f"0:{PHANTOM_ROWS}" if phantom else None,
    )
    scan_id = store.scans.accept(spec, received).id
    _run_next(store)
    return scan_id


def _run_next(store: Store) -> None:
    """The oldest job, in this process."""
    claim = store.jobs.claim("history")
    assert claim is not None
    output = store.files.make_attempt_folder(claim.job_id, claim.attempt)
    job = store.jobs.get(claim.job_id)
    attempt = Attempt(
        job=job, given=given_to(store, job), output=output, report=lambda _: None, announce=lambda _: None
    )
    store.jobs.succeed(claim, run(attempt), output)
