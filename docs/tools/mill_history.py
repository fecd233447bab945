"""A data folder of a mill whose scanners have been watched for weeks: what pages are shown and measured with.

Nothing in it is invented but the scans: every calibration, drift check and slice is computed from a simulated scan by
the job that a service would run, at a given time in the past. `write_history(store, clock)` takes about a second
for each scanner and day.
"""

import io
import math
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

from sawmill_calibration.simulation import write_simulated_scan
from sawmill_command import examples
from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_store.store import Store
from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.simulate import simulate_stack
from sawmill_vocabulary import DataKind
from sawmill_vocabulary.physics import DetectorEffects, Physics

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from waiting_job import do_waiting_job

# Coarser cells than the example's scanner, and 120 views, the fewest that a drift check takes: a day costs a second.
SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=384, detector_pitch_mm=3.0)
VIEWS, ROW_PITCH_MM = 120, 4.0
PHANTOM_ROWS, LOG_ROWS, SHOWN_LOG_ROWS = 2, 1, 12
WEEK_DAYS = 7
# A strong tube: the checks of one row of such coarse cells scatter by a tenth of the tolerance.
PHOTONS = 300_000.0
DRY_WOOD_PER_MM = 0.009
PHYSICS = Physics(detector=DetectorEffects(gain_spread=0.03, air_of_full_scale=0.8))
STEADY_MM = 0.2
SEED = 14  # simulated scans are those of this seed, of their scanner's number and of their day


@dataclass
class PastClock:
    """The store's clock, set by the writer of the past."""

    now: datetime = field(default_factory=lambda: datetime.now(UTC))

    def __call__(self) -> datetime:
        """Return the time that rows are stamped with."""
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
    Line("Line 4", lambda _: 0.0, watched=False),
)


def write_history(store: Store, clock: PastClock, *, lines: Sequence[Line] = LINES, days: int = 60) -> None:
    """Write scanners with a phantom scan a week, calibrated, and a log a day, checked for drift.

    The first calibration is the active one. Today each line has a phantom scan, and one that has not moved the slices
    of a longer log.
    """
    today = clock.now
    clock.now = today - timedelta(days=days + 1)
    ids = [_scanner(store, line) for line in lines]
    for number, line in enumerate(lines):
        log = LogModel.random(SEED + number)
        for day in range(days, -1, -1) if line.watched else ():
            clock.now = today - timedelta(days=day, hours=1, minutes=7 * number)
            _day(store, clock, _Scans(ids[number], line, log, seed=1000 * number + day), day, first=day == days)
    clock.now = today
    for scanner_id in ids:
        # Only now: a service would catch up with what a schedule of the past has missed.
        store.schedules.create(ScheduleSpec(scanner_id=scanner_id, cron="30 5 * * 1-6"))


@dataclass(frozen=True)
class _Scans:
    """The scans that one line's scanner delivers on one day."""

    scanner_id: str
    line: Line
    log: LogModel
    seed: int

    def stack(self, day: int, *, phantom: bool, log_rows: int) -> bytes:
        """Simulate counts as an NXtomo file: the phantom's rows, where it is on the log, then the log's."""
        bodies = [_phantom()] * (PHANTOM_ROWS if phantom else 0)
        bodies += [self.log.slice_at(examples.LOG_START_MM + row * ROW_PITCH_MM) for row in range(log_rows)]
        angles, frame = examples.full_turn(VIEWS), examples.THETA.source_frame(SCANNER.source_to_cor_mm)
        # The COR moves along the detector.
        moved = replace(frame, cor_column_mm=frame.cor_column_mm + self.line.moved_mm(day))
        stack = simulate_stack(
            bodies,
            FanBeamGeometry(SCANNER, moved.theta(SCANNER.source_to_cor_mm), angles),
            PHYSICS,
            photons=PHOTONS,
            seed=SEED + self.seed,
        )
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "scan.h5"
            write_simulated_scan(path, stack, angles, SCANNER, ROW_PITCH_MM)
            return path.read_bytes()


def _phantom() -> Phantom:
    return L_SHAPE.of_density(DRY_WOOD_PER_MM).moved(3.0, -2.0)


def _scanner(store: Store, line: Line) -> str:
    constants = ScannerConstants(**vars(SCANNER), row_pitch_mm=ROW_PITCH_MM)
    return store.scanners.create(ScannerSpec(name=line.name, constants=constants, log_radius_mm=150.0)).id


def _day(store: Store, clock: PastClock, scans: _Scans, day: int, *, first: bool) -> None:
    phantom = first or day % WEEK_DAYS == 0
    shown = day == 0 and abs(scans.line.moved_mm(0)) < STEADY_MM
    rows = SHOWN_LOG_ROWS if shown else LOG_ROWS
    content = scans.stack(day, phantom=phantom, log_rows=rows)
    scan_id = _uploaded(store, scans.scanner_id, content, clock.now.date(), phantom=phantom)
    clock.now += timedelta(minutes=1)
    if not phantom:
        store.drifts.accept(DriftRequest(scan_id=scan_id))
        do_waiting_job(store, kinds.DRIFT)
        return
    asked = store.calibrations.accept(CalibrationRequest(scan_id=scan_id))
    do_waiting_job(store, kinds.CALIBRATE)
    if first:
        store.calibrations.activate(asked.id, "the first calibration")
    if shown:
        store.reconstructions.accept(
            ReconstructionRequest(scan_id=scan_id, rows=f"{PHANTOM_ROWS}:{PHANTOM_ROWS + rows}")
        )
        do_waiting_job(store, kinds.RECONSTRUCT)


def _uploaded(store: Store, scanner_id: str, content: bytes, day: date, *, phantom: bool) -> str:
    """Store an upload and have it read; return the scan's id."""
    spec = ScanSpec(
        scanner_id=scanner_id,
        name=f"Phantom and log, {day}" if phantom else f"Log, {day}",
        data=DataKind.COUNTS,
        phantom_id="l-shape" if phantom else None,
        phantom_rows=f"0:{PHANTOM_ROWS}" if phantom else None,
    )
    scan_id = store.scans.accept(spec, store.files.receive(io.BytesIO(content), max_bytes=2**30)).id
    do_waiting_job(store, kinds.INGEST)
    return scan_id
