"""Ranges of detector rows in requests, A:B and A:B:STEP, and numbers of views."""

import re
from typing import Annotated

from pydantic import AfterValidator, Field

# Expressions for clients: `parse_span` reads rows; no expression states that A is less than B.
ROWS = r"^[0-9]{1,9}:[1-9][0-9]{0,8}$"
STEPPED_ROWS = r"^[0-9]{1,9}:[1-9][0-9]{0,8}(:[1-9][0-9]{0,8})?$"
_SPAN = re.compile(r"([0-9]{1,9}):([0-9]{1,9})(?::([0-9]{1,9}))?")


def parse_span(what: str, text: str) -> slice:
    """Read A:B or A:B:STEP as a slice.

    Raises
    ------
    ValueError
        The text has neither form, or the slice is empty.
    """
    match = _SPAN.fullmatch(text)
    first, last, step = (None if part is None else int(part) for part in match.groups()) if match else (0, 0, None)
    if first is None or last is None or first >= last or step == 0:
        raise ValueError(f"{what} must be A:B with 0 <= A < B, as in 0:16, or A:B:STEP, as in 0:2500:10, not {text!r}")
    return slice(first, last, step)


def parse_rows(rows: str) -> slice:
    """Read A:B or A:B:STEP as a slice of rows."""
    return parse_span("rows", rows)


def _check_rows(text: str) -> str:
    if parse_rows(text).step is not None:
        raise ValueError(f"rows that are averaged must be A:B, without a step, not {text!r}")
    return text


Rows = Annotated[
    str,
    AfterValidator(_check_rows),
    Field(
        description="Detector rows A:B with A < B, the first included, the last not.",
        examples=["0:16"],
        json_schema_extra={"pattern": ROWS},
    ),
]
SteppedRows = Annotated[
    str,
    AfterValidator(lambda text: parse_rows(text) and text),
    Field(
        description="Detector rows A:B, the first included, the last not, or every STEP-th of them, A:B[:STEP].",
        examples=["0:16", "0:2500:10"],
        json_schema_extra={"pattern": STEPPED_ROWS},
    ),
]
ChosenViews = Annotated[int, Field(ge=3, le=100_000)]
