"""Drawings of phantoms by name, from a file, or from a picture."""

from pathlib import Path

from pydantic import ValidationError

from sawmill_calibration.conversion import from_phantom
from sawmill_calibration.input_errors import InputError, input_errors, options_of
from sawmill_calibration.phantom_drawings import read_drawing, traced_drawing
from sawmill_contracts.built_in import BUILT_IN_PHANTOMS
from sawmill_contracts.phantoms import PhantomDrawing, PhantomPicture
from sawmill_platform.contracts.base import complaint
from sawmill_tomography.phantoms.phantom import Phantom


def drawing_of(phantom: Phantom | str | Path, width_mm: float | None = None) -> PhantomDrawing:
    """Return a phantom's drawing: a built-in one by its name, from a JSON file, or from a picture of a given width.

    Raises
    ------
    InputError
        The argument is none of these.
    """
    if width_mm is not None:
        if isinstance(phantom, Phantom) or not Path(phantom).is_file():
            raise InputError("phantom", f"phantom_width_mm belongs to the path of a picture (PNG), not to {phantom!r}")
        picture = options_of(PhantomPicture, {"name": Path(phantom).stem, "width_mm": width_mm})
        with input_errors():
            return traced_drawing(Path(phantom), picture.width_mm, name=picture.name)
    if isinstance(phantom, Phantom):
        try:
            return from_phantom(phantom)
        except ValidationError as error:
            raise InputError("phantom", complaint(error)) from error
    if phantom in BUILT_IN_PHANTOMS:
        return BUILT_IN_PHANTOMS[str(phantom)]
    if not Path(phantom).is_file():
        raise InputError("phantom", f"a phantom must be {', '.join(BUILT_IN_PHANTOMS)} or a file, not {str(phantom)!r}")
    with input_errors():
        return read_drawing(Path(phantom))
