"""Find out what is in an upload, what of it would be read as a scan, and what is missing."""

from typing import Any

from sawmill_contracts.inspections import Inspection
from sawmill_formats.input.angles import parse_angles
from sawmill_platform.attempts.work import Needs
from sawmill_worker.jobs.attempt import Attempt
from sawmill_worker.use_cases.inspect import GivenBeside, inspect_file


def run(attempt: Attempt) -> dict[str, Any]:
    """Answer with what was found; a file that cannot be read is no failure of the job."""
    options = attempt.asked(Inspection).options
    attempt.report_stage(0.1, "inspect")
    given = GivenBeside(
        attempt.file,
        data=options.data,
        dataset=options.dataset,
        angles=None if options.angles_deg is None else parse_angles(options.angles_deg),
        transpose=options.transpose,
        uploaded=True,
    )
    return inspect_file(given).model_copy(update={"file": options.name}).model_dump(mode="json")


def needs(_: Attempt) -> Needs:
    """None beyond what every job may take."""
    return Needs(0, 0)
