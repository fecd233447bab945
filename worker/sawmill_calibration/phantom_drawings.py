"""A phantom's drawing, read from a file or traced from a picture."""

from pathlib import Path

from pydantic import ValidationError

from sawmill_calibration.capacity import memory_available
from sawmill_calibration.conversion import from_phantom
from sawmill_calibration.failures import refused
from sawmill_calibration.json_file import read_json
from sawmill_contracts.phantoms import PhantomAsk, PhantomDrawing
from sawmill_formats.input.picture import read_picture
from sawmill_platform.contracts.base import complaint
from sawmill_tomography.phantoms.tracing import trace
from sawmill_vocabulary import STANDARD_SIZE_TOLERANCE


def read_drawing(path: Path) -> PhantomDrawing:
    """Read a drawing from a JSON file.

    Raises
    ------
    JobFailure
        The file holds no phantom.
    """
    return read_json(path, PhantomAsk, code="phantom", otherwise="not a phantom's drawing")


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
