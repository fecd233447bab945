"""A phantom's drawing traced from a picture."""

from pathlib import Path

from pydantic import ValidationError

from sawmill_worker.contracts.base import complaint
from sawmill_worker.contracts.phantoms import PhantomDrawing
from sawmill_worker.readers.picture import read_picture
from sawmill_worker.tomography.tracing import trace
from sawmill_worker.use_cases.capacity import memory_available
from sawmill_worker.use_cases.conversion import from_phantom
from sawmill_worker.use_cases.failures import refused
from sawmill_worker.vocabulary import STANDARD_SIZE_TOLERANCE


def traced_drawing(
    path: Path, width_mm: float, *, name: str, size_tolerance: float = STANDARD_SIZE_TOLERANCE
) -> PhantomDrawing:
    """Trace the drawing in a PNG whose width is `width_mm`.

    Raises
    ------
    JobFailure, UnreadableScan, PhantomError
        The picture cannot be read, or shows no phantom.
    """
    picture = read_picture(path, free_bytes=memory_available())
    try:
        return from_phantom(trace(picture, width_mm, name=name, size_tolerance=size_tolerance))
    except ValidationError as error:
        raise refused("phantom", f"the picture shows no phantom that can be drawn: {complaint(error)}") from error
