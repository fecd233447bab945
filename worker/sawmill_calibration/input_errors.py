"""The error of all input that cannot lead to a result."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError
from pydantic_core import to_json

from sawmill_calibration.failures import input_errors_translated
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.base import placed_complaint
from sawmill_platform.contracts.jobs import FailureKind
from sawmill_platform.contracts.strict_json import read_strictly

Options = TypeVar("Options")


class InputError(ValueError):
    """A file, a scan or an option that cannot lead to a result.

    The message is one sentence: which value, and what would be right.

    Attributes
    ----------
    code : str
        Stable name for programs: one of docs/look-up/codes.md, or `options`.
    """

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code


@contextmanager
def input_errors() -> Iterator[None]:
    """Turn the errors of readers, science and use cases about unusable input into an `InputError`."""
    try:
        with input_errors_translated():
            yield
    except JobFailure as failure:
        if failure.kind is not FailureKind.INPUT:
            raise
        raise InputError(failure.code, failure.detail) from failure


def options_of(contract: type[Options], raw_options: object) -> Options:
    """Read options as their contract, a model or a dataclass of pydantic, takes them in JSON: True is not 1 there.

    Raises
    ------
    InputError
        An option is unknown, or its value is not allowed.
    """
    try:
        sent = to_json(raw_options, inf_nan_mode="constants", fallback=_plain)
        options: Options = read_strictly(TypeAdapter(contract), sent)
    except ValidationError as error:
        raise InputError("options", placed_complaint(error)) from error
    except ValueError as error:  # half a surrogate, or a list that contains itself
        raise InputError("options", f"an option cannot be read: {error}") from error
    return options


def _plain(value: object) -> object:
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else repr(value)
