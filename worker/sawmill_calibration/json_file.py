"""A JSON file that holds one contract."""

from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError

from sawmill_calibration.failures import refused
from sawmill_platform.contracts.base import placed_complaint
from sawmill_platform.contracts.strict_json import read_strictly

Held = TypeVar("Held")


def read_json(path: Path, contract: type[Held], *, code: str, otherwise: str) -> Held:
    """Read a contract, which is a model or a dataclass of pydantic, from a file.

    Parameters
    ----------
    code, otherwise : str
        Code and wording of the refusal; its sentence says that the file is `otherwise`, and what is wrong where.

    Raises
    ------
    JobFailure
        The file holds something else.
    """
    try:
        held: Held = read_strictly(TypeAdapter(contract), path.read_bytes())
    except ValidationError as error:
        raise refused(code, f"{path.name} is {otherwise}: {placed_complaint(error)}") from error
    return held
