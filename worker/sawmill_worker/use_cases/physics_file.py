"""Physical effects of a mill in a file."""

from pathlib import Path

from sawmill_vocabulary.physics import Physics
from sawmill_worker.use_cases.json_file import read_json


def read_physics(path: Path) -> Physics:
    """Read physical effects from a JSON file; docs/simulating.md lists the fields.

    Raises
    ------
    JobFailure
        The file holds something else.
    """
    return read_json(path, Physics, code="physics", otherwise="no file of physics")
