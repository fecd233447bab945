"""Trace a phantom's picture to outlines in mm."""

from typing import Any

from sawmill_worker.jobs.attempt import Attempt
from sawmill_worker.jobs.needs import Needs
from sawmill_worker.readers.picture import read_picture
from sawmill_worker.tomography.tracing import trace
from sawmill_worker.use_cases.capacity import memory_available
from sawmill_worker.use_cases.conversion import from_phantom


def run(attempt: Attempt) -> dict[str, Any]:
    """Answer with the drawing."""
    asked = attempt.given.picture
    assert asked is not None  # noqa: S101 - of the one kind that traces
    attempt.report_stage(0.1, "trace")
    picture = read_picture(attempt.file, free_bytes=memory_available())
    traced = trace(picture, asked.width_mm, name=asked.name, size_tolerance=asked.size_tolerance)
    return from_phantom(traced).model_dump(mode="json")


def needs(_: Attempt) -> Needs:
    """None beyond what every job may take."""
    return Needs(0, 0)
