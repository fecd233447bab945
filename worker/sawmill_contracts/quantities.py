"""Quantities that several contracts share."""

from typing import Annotated

from pydantic import AfterValidator, Field

from sawmill_vocabulary import LARGEST_MM

PositiveMm = Annotated[float, Field(gt=0, le=LARGEST_MM)]
ChosenViews = Annotated[int, Field(ge=3, le=100_000)]


def _check_square(rows: list[list[float]]) -> list[list[float]]:
    lengths = [len(row) for row in rows]
    if not rows or lengths != [len(rows)] * len(rows):
        msg = f"a covariance must have as many numbers in each row as it has rows, not {lengths} in {len(rows)} rows"
        raise ValueError(msg)
    return rows


Covariance = Annotated[list[list[float]], AfterValidator(_check_square)]
