"""A phantom's drawing in a file."""

from pathlib import Path

from pydantic import ValidationError

from sawmill_worker.contracts.base import placed_complaint
from sawmill_worker.contracts.phantoms import PhantomAsk, PhantomDrawing
from sawmill_worker.use_cases.failures import refused


def read_drawing(path: Path) -> PhantomDrawing:
    """The drawing in a JSON file.

    Raises
    ------
    JobFailure
        The file holds no phantom.
    """
    try:
        return PhantomAsk.model_validate_json(path.read_bytes())
    except ValidationError as error:
        raise refused("phantom", f"{path.name} is not a phantom's drawing: {placed_complaint(error)}") from error
