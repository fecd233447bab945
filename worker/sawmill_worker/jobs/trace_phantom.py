"""The job that traces a phantom's picture to outlines in mm."""

from typing import Any

from sawmill_calibration.known_geometry import traced_drawing
from sawmill_platform.attempts.protocol import Needs
from sawmill_worker.jobs.attempt import MillAttempt


def run(attempt: MillAttempt) -> dict[str, Any]:
    """Return the drawing."""
    picture = attempt.given.picture
    assert picture is not None  # noqa: S101 - required by this kind of job
    attempt.report_stage(0.1, "trace")
    drawing = traced_drawing(attempt.file, picture.width_mm, name=picture.name, size_tolerance=picture.size_tolerance)
    return drawing.model_dump(mode="json")


def needs(_: MillAttempt) -> Needs:
    """Return no needs beyond the common limits."""
    return Needs(0, 0)
