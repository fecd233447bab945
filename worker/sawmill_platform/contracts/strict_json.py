"""Strict JSON, in which "1" and true are not 1, and 20.0 is a whole number as in JSON Schema."""

from contextlib import suppress
from typing import Any

from pydantic import TypeAdapter
from pydantic_core import from_json, to_json

# Bytes with which .NET and PowerShell begin texts.
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_EXACT = 2**53


def read_strictly(contract: TypeAdapter[Any], text: bytes) -> Any:  # noqa: ANN401 - what the contract is of
    """Read JSON as a contract.

    Raises
    ------
    ValidationError
        The text is no JSON, or not what the contract describes.
    """
    text = text.removeprefix(BYTE_ORDER_MARK)
    with suppress(ValueError):  # the contract refuses what is no JSON
        text = to_json(_with_whole_numbers(from_json(text)), inf_nan_mode="constants")
    return contract.validate_json(text, strict=True)


def _with_whole_numbers(value: Any) -> Any:  # noqa: ANN401 - JSON
    """Replace each 20.0 by 20, also in lengths: some programs write every number as a float."""
    if isinstance(value, dict):
        return {name: _with_whole_numbers(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_with_whole_numbers(each) for each in value]
    return int(value) if isinstance(value, float) and value.is_integer() and abs(value) < _EXACT else value
