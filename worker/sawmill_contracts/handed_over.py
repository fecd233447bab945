"""Input of an attempt, which the worker hands to the attempt's process: rows as stored at its start, and paths.

The process reads untrusted files, so it has access neither to the database nor to the data folder.
"""

from sawmill_contracts.calibrations import Calibration
from sawmill_contracts.drifts import KnownBaseline
from sawmill_contracts.fixed_pairs import FixedPairs
from sawmill_contracts.phantoms import PhantomPicture, StoredPhantom
from sawmill_contracts.scanners import StoredScanner
from sawmill_contracts.scans import Scan
from sawmill_platform.contracts.attempts import AttemptInput


class HandedOver(AttemptInput):
    """Rows that the job's own row refers to; null where it refers to none."""

    asked_json: str | None = None  # the job's row, by the contract of the kind; null: the job reads an upload
    scan: Scan | None = None
    scanner: StoredScanner | None = None
    phantom: StoredPhantom | None = None
    picture: PhantomPicture | None = None  # the picture that the job traces
    calibration: Calibration | None = None
    fixed_pairs: FixedPairs | None = None
    active: Calibration | None = None  # the scanner's active one, for a job on a scan that names none
    baselines: tuple[KnownBaseline, ...] = ()  # of the calibration, for a drift check; at most one for each method
