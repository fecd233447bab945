"""The job that reports what an upload holds, which part would be read as a scan, and what is missing, and draws it."""

from typing import Any

from sawmill_calibration.scans.inspect import InspectionInput, inspect_file
from sawmill_contracts.inspections import Inspection
from sawmill_formats.input.angles import parse_angles
from sawmill_platform.attempts.protocol import Needs
from sawmill_worker.jobs.attempt import MillAttempt


def run(attempt: MillAttempt) -> dict[str, Any]:
    """Return what the file holds; a file that cannot be read does not make the job fail."""
    options = attempt.asked(Inspection).options
    attempt.report_stage(0.1, "inspect")
    source = InspectionInput(
        attempt.file,
        data=options.data,
        dataset=options.dataset,
        angles=None if options.angles_deg is None else parse_angles(options.angles_deg),
        transpose=options.transpose,
        axes=options.axes,
        uploaded=True,
        pictures=attempt.output,
    )
    return inspect_file(source).model_copy(update={"file": options.name}).model_dump(mode="json")


def needs(_: MillAttempt) -> Needs:
    """Return no needs beyond the common limits."""
    return Needs(0, 0)
