"""Input of an attempt, which the worker hands to the attempt's process: rows as stored at its start, and two paths.

The process reads untrusted files, so it has access neither to the database nor to the data folder.
"""

from sawmill_contracts.calibrations import Calibration
from sawmill_contracts.drifts import KnownBaseline
from sawmill_contracts.phantoms import PhantomPicture, StoredPhantom
from sawmill_contracts.scanners import StoredScanner
from sawmill_contracts.scans import Scan
from sawmill_platform.contracts.attempts import AttemptInput


class HandedOver(AttemptInput):
    """Rows that the job's own row refers to; null where it refers to none.

    Attributes
    ----------
    asked_json
        The job's row, of the contract that its kind answers with; null: the job reads an upload.
    picture
        Name and size of the picture that the job traces.
    active
        The scanner's active calibration, for a job on a scan that names none.
    baselines
        Baselines of the calibration, for a drift check; at most one for each method.
    file
        The upload, or the scan that was made of one; null: the job reads none, or the scan was refused.
    """

    asked_json: str | None = None
    scan: Scan | None = None
    scanner: StoredScanner | None = None
    phantom: StoredPhantom | None = None
    picture: PhantomPicture | None = None
    calibration: Calibration | None = None
    active: Calibration | None = None
    baselines: tuple[KnownBaseline, ...] = ()
