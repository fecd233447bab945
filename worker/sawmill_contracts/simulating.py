"""Options of a simulated scan, as numbers with bounds."""

from typing import Annotated

from pydantic import Field

from sawmill_platform.contracts.base import Contract
from sawmill_vocabulary import LARGEST_MM


class SimulationOptions(Contract):
    """Options of a simulated scan, apart from body, scanner, geometry and physics."""

    views: Annotated[int, Field(ge=1, le=100_000)] = Field(360, description="Number of views.")
    rows: Annotated[int, Field(ge=1, le=100_000)] = Field(1, description="Rows of the stack.")
    noise: Annotated[float, Field(ge=0, le=100)] = Field(
        0.0, description="Of line integrals: standard deviation against their RMS."
    )
    background: Annotated[float, Field(ge=-LARGEST_MM, le=LARGEST_MM)] = Field(
        0.0, description="Of line integrals: added everywhere."
    )
    photons: Annotated[float, Field(ge=1, le=1e9)] = Field(30_000.0, description="Of counts: in air, a cell and view.")
    seed: Annotated[int, Field(ge=0, lt=2**32)] = Field(1, description="Of the log and of all noise.")
