"""Every code that the sources can fail a job with is in the closed list."""

import ast
from pathlib import Path

from sawmill_calibration.scans.inspect import NO_SCAN
from sawmill_contracts.failure_codes import CODES, OTHER, counted_as
from sawmill_contracts.kinds import Reference
from sawmill_platform.errors import DamagedResult, StorageFull, StorageUnavailable

WORKER = Path(__file__).parents[3] / "worker"
ROOMS = (
    "sawmill_platform/attempts",
    "sawmill_platform/confinement",
    "sawmill_platform/jobs",
    "sawmill_formats",
    "sawmill_tomography",
    "sawmill_worker/jobs",
    "sawmill_calibration",
)
# Where the code stands among the arguments.
RAISED = {"refused": 0, "UnreadableScan": 0, "CalibrationError": 0, "DriftError": 0, "JobFailure": 1}


def codes_in(path: Path) -> set[str]:
    """Literals that stand where a code does, those between which an expression chooses included."""
    found = set()
    for call in ast.walk(ast.parse(path.read_text())):
        if isinstance(call, ast.Call):
            name = getattr(call.func, "id", None)
            given = call.args[RAISED[name] :][:1] if name in RAISED else []
            given += [keyword.value for keyword in call.keywords if keyword.arg == "code"]
            literals = (part for code in given for part in ast.walk(code))
            found |= {part.value for part in literals if isinstance(part, ast.Constant) and isinstance(part.value, str)}
    return found


def test_the_list_has_the_codes_of_the_sources():
    paths = [path for room in ROOMS for path in (WORKER / room).rglob("*.py")]
    found = {code for path in paths for code in codes_in(path)}
    assert len(found) > 50  # else the search finds nothing
    # What a job works on may have been deleted before it is handed over (`sawmill_store/subjects/mill_subjects.py`).
    gone = {f"{kind}-deleted" for kind in Reference if kind is not Reference.THETA}
    no_scans = {code for code, _ in NO_SCAN.values()}
    raised = found | {StorageFull.code, StorageUnavailable.code, DamagedResult.code} | gone | no_scans
    assert not raised - CODES, "add these to sawmill_contracts/failure_codes.py"
    assert not CODES - raised, "no job fails with these: take them out of sawmill_contracts/failure_codes.py"


def test_a_code_that_is_not_in_the_list_counts_as_another():
    assert counted_as("worker-lost") == "worker-lost"
    assert counted_as("<invented>") == counted_as(None) == OTHER
