"""Which phantom is meant."""

from pathlib import Path

from pydantic import ValidationError

from sawmill_calibration.input_errors import InputError, input_errors
from sawmill_worker.contracts.base import complaint
from sawmill_worker.contracts.built_in import BUILT_IN_PHANTOMS
from sawmill_worker.contracts.phantoms import PhantomDrawing
from sawmill_worker.tomography.phantom import Phantom
from sawmill_worker.use_cases.conversion import from_phantom
from sawmill_worker.use_cases.phantom_file import read_drawing


def drawing_of(phantom: Phantom | str | Path) -> PhantomDrawing:
    """The drawing of a phantom, of a built-in one by its name, or in a JSON file.

    Raises
    ------
    InputError
        It is none of the three.
    """
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
