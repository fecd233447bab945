"""Program of the workers of a mill."""

from functools import partial

from sawmill_platform.attempts.importing import PROGRAM
from sawmill_platform.workers.program import WorkerProgram
from sawmill_store.store import Store
from sawmill_worker.housekeeping import MillHousekeeping

# Without the folder that the worker was started in on the path for imports.
ATTEMPT_COMMAND = (*PROGRAM, "sawmill_worker.attempt")

MILL = WorkerProgram(partial(Store.open, may_begin=False), MillHousekeeping, ATTEMPT_COMMAND)
