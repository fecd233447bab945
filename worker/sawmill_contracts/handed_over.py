"""What an attempt works on, handed to its process by the worker: rows as they are at its start, and two paths.

The process reads strangers' files, so it has neither the database nor the data folder.
"""

from sawmill_contracts.calibrations import Calibration
from sawmill_contracts.drift_baselines import KnownBaseline
from sawmill_contracts.phantoms import PhantomPicture, StoredPhantom
from sawmill_contracts.scanners import StoredScanner
from sawmill_contracts.scans import Scan
from sawmill_platform.contracts.attempts import AttemptInput


class HandedOver(AttemptInput):
    """Rows that the job's own one refers to; null: it refers to none.

    Attributes
    ----------
    asked_json
        The job's row, of the contract that its kind answers with; null: the job reads an upload.
    picture
        What came with the picture that the job traces.
    active
        The scanner's active calibration, for a job on a scan that names none.
    baselines
        What the first logs after the calibration measured, for a drift check; of each method none or one.
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
