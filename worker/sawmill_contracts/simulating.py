"""Options of a simulated scan, as numbers with bounds."""

from typing import Annotated

from pydantic import Field

from sawmill_platform.contracts.base import Contract
from sawmill_vocabulary import LARGEST_MM


class SimulationOptions(Contract):
    """Options of a simulated scan, apart from body, scanner, geometry and physics."""

    views: Annotated[int, Field(ge=1, le=100_000)] = Field(360, description="Number of views.")
    rows: Annotated[int, Field(ge=1, le=100_000)] = Field(1, description="Number of rows of the stack.")
    noise: Annotated[float, Field(ge=0, le=100)] = Field(
        0.0, description="Standard deviation of the line integrals' noise, relative to their RMS."
    )
    background: Annotated[float, Field(ge=-LARGEST_MM, le=LARGEST_MM)] = Field(
        0.0, description="Constant that is added to all line integrals."
    )
    photons: Annotated[float, Field(ge=1, le=1e9)] = Field(
        30_000.0, description="Number of photons in air, a cell and view, for counts."
    )
    seed: Annotated[int, Field(ge=0, lt=2**32)] = Field(
        1, description="Seed of the log's and all noise's random numbers."
    )
