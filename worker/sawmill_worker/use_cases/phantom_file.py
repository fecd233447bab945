"""A phantom's drawing in a file."""

from pathlib import Path

from sawmill_contracts.phantoms import PhantomAsk, PhantomDrawing
from sawmill_worker.use_cases.json_file import read_json


def read_drawing(path: Path) -> PhantomDrawing:
    """Read a drawing from a JSON file.

    Raises
    ------
    JobFailure
        The file holds no phantom.
    """
    return read_json(path, PhantomAsk, code="phantom", otherwise="not a phantom's drawing")
