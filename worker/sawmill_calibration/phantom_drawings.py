"""A phantom's drawing: built-in, read from a file or traced from a picture."""
# ruff: noqa: PLC0415 - a built-in phantom needs no readers of files and pictures

from pathlib import Path

from pydantic import ValidationError

from sawmill_calibration.failures import input_errors_translated, memory_available, options_of, read_json, refused
from sawmill_calibration.known_geometry import from_phantom
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS, PhantomDrawing, PhantomPicture, PhantomRequest
from sawmill_platform.contracts.base import complaint
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_vocabulary import STANDARD_SIZE_TOLERANCE


def drawing_of(phantom: Phantom | str | Path, width_mm: float | None = None) -> PhantomDrawing:
    """Return a phantom's drawing by its built-in name, from a JSON file, or from a picture of this width."""
    if width_mm is not None:
        if isinstance(phantom, Phantom) or not Path(phantom).is_file():
            raise refused("phantom", f"phantom_width_mm belongs to the path of a picture (PNG), not to {phantom!r}")
        picture = options_of(PhantomPicture, {"name": Path(phantom).stem, "width_mm": width_mm})
        return traced_drawing(Path(phantom), picture.width_mm, name=picture.name)
    if isinstance(phantom, Phantom):
        try:
            return from_phantom(phantom)
        except ValidationError as error:
            raise refused("phantom", complaint(error)) from error
    if phantom in BUILT_IN_PHANTOMS:
        return BUILT_IN_PHANTOMS[str(phantom)]
    if not Path(phantom).is_file():
        raise refused("phantom", f"a phantom must be {', '.join(BUILT_IN_PHANTOMS)} or a file, not {str(phantom)!r}")
    return read_json(Path(phantom), PhantomRequest, code="phantom", otherwise="not a phantom's drawing")


def traced_drawing(
    path: Path, width_mm: float, *, name: str, size_tolerance: float = STANDARD_SIZE_TOLERANCE
) -> PhantomDrawing:
    """Trace the drawing in a PNG of this width, or refuse it."""
    from sawmill_formats.input.picture import read_picture
    from sawmill_tomography.phantoms.tracing import trace

    with input_errors_translated():
        picture = read_picture(path, free_bytes=memory_available())
        try:
            return from_phantom(trace(picture, width_mm, name=name, size_tolerance=size_tolerance))
        except ValidationError as error:
            raise refused("phantom", f"the picture shows no phantom that can be drawn: {complaint(error)}") from error
