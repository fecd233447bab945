"""The origin of a result: a digest of all that it depends on, the same for two jobs only if they compute the same.

Whatever a job is handed over is a part of it, apart from what is named here: ids and names, which no result depends on.
What an uploaded file holds counts by its digest, so that the same file under two ids is the same.
"""

import hashlib
import json
from datetime import UTC, datetime
from typing import Any

from sawmill_worker.contracts.calibrations import CalibrationResult
from sawmill_worker.contracts.handed_over import HandedOver
from sawmill_worker.contracts.jobs import JobKind

_IDS_ASKED_FOR = {"scan_id", "scanner_id", "calibration_id"}
_NOT_OF_SCAN = {"id", "created_at", "name", "scanner_id", "phantom_id", "state", "reason", "job_id"}
_NOT_OF_SCANNER = {"id", "created_at", "name", "active_calibration_id", "alarms"}
# How long it took and what was active then: no result that uses a calibration depends on them.
_OF_CALIBRATION = CalibrationResult.model_fields.keys() - {"timing_s", "comparison"}


def origin_of(kind: JobKind, given: HandedOver, software: str) -> str | None:
    """The digest, in hexadecimal digits; None where nothing tells what is in the file that the job reads.

    Parameters
    ----------
    kind
        What is computed.
    given
        All that it is computed from.
    software
        That which computes it (`storage/software.py`).
    """
    if given.picture is not None:
        return None
    depends_on = {
        "kind": kind.value,
        "software": software,
        "options": _options(given),
        "scan": given.scan and given.scan.model_dump(mode="json", exclude=_NOT_OF_SCAN),
        "scan_origin": given.scan_origin,
        "scanner": given.scanner and given.scanner.model_dump(mode="json", exclude=_NOT_OF_SCANNER),
        "drawing": given.phantom and given.phantom.drawing and given.phantom.drawing.model_dump(mode="json"),
        "expired": _expired(given),
        "calibration": given.calibration and given.calibration.model_dump(mode="json", include=set(_OF_CALIBRATION)),
        "baselines": [each.model_dump(mode="json") for each in given.baselines],
        # The comparison with it states its id.
        "active": given.active and given.active.id,
    }
    return hashlib.sha256(json.dumps(depends_on, sort_keys=True, allow_nan=False).encode()).hexdigest()


def _expired(given: HandedOver) -> list[str]:
    """Which measurements of the phantom a calibration of today would ask to repeat."""
    drawing = None if given.phantom is None else given.phantom.drawing
    today = datetime.now(UTC).date()
    return [] if drawing is None else [measured.what for measured in drawing.measurements if measured.expired(today)]


def _options(given: HandedOver) -> dict[str, Any] | None:
    if given.asked_json is None:
        return None
    options: dict[str, Any] = json.loads(given.asked_json)["options"]
    return {name: value for name, value in options.items() if name not in _IDS_ASKED_FOR}
