"""Kinds of jobs of a mill: a line a kind, with its name and the plural of what it works on.

Everything else is found by these two names:

sawmill_contracts/<plural>.py    the contracts, and `DECLARATION`, an `AskedKind` or an `UploadedKind`
sawmill_worker/jobs/<kind>.py    `run(attempt)`, which does the job, and `needs(attempt)`, its memory and largest file
/v1/<plural>                     the routes of a kind that is asked for
<plural>/<id>/                   its files in the data folder
"""

from sawmill_platform.contracts.jobs import JobKind

INGEST = JobKind.register("ingest", "scans")
TRACE_PHANTOM = JobKind.register("trace-phantom", "phantoms")
CALIBRATE = JobKind.register("calibrate", "calibrations")
RECONSTRUCT = JobKind.register("reconstruct", "reconstructions")
PLAN = JobKind.register("plan", "plans")
DRIFT = JobKind.register("drift", "drifts")
INSPECT = JobKind.register("inspect", "inspections")
