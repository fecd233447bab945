"""A mill's physics in a file."""

from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from sawmill_worker.contracts.base import placed_complaint
from sawmill_worker.use_cases.failures import refused
from sawmill_worker.vocabulary.physics import Physics

_ADAPTER = TypeAdapter(Physics)


def read_physics(path: Path) -> Physics:
    """The effects in a JSON file; docs/simulating.md has its fields.

    Raises
    ------
    JobFailure
        The file holds something else.
    """
    try:
        return _ADAPTER.validate_json(path.read_bytes())
    except ValidationError as error:
        raise refused("physics", f"{path.name} is no file of physics: {placed_complaint(error)}") from error
