"""Kinds of jobs of a mill: a line a kind, with its name and the plural of what it works on.

Everything else is found by these two names:

sawmill_contracts/<plural>.py    the contracts, and `DECLARATION`, an `AskedKind` or an `UploadedKind`
sawmill_worker/jobs/<kind>.py    `run(attempt)`, which does the job, and `needs(attempt)`, its memory and largest file
/v1/<plural>                     the routes of a kind that is asked for
<plural>/<id>/                   its files in the data folder
"""

from sawmill_platform.contracts.jobs import JobKind


def _kind(name: str, plural: str) -> JobKind:
    return JobKind.register(name, plural, declared_in=f"sawmill_contracts.{plural}")


INGEST = _kind("ingest", "scans")
TRACE_PHANTOM = _kind("trace-phantom", "phantoms")
CALIBRATE = _kind("calibrate", "calibrations")
RECONSTRUCT = _kind("reconstruct", "reconstructions")
PLAN = _kind("plan", "plans")
DRIFT = _kind("drift", "drifts")
INSPECT = _kind("inspect", "inspections")
