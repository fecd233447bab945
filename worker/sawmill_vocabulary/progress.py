"""Progress of a running job: the one type of progress."""

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Progress:
    """Progress of a running job."""

    fraction: float = field(
        metadata={"ge": 0, "le": 1, "description": "Share of the work that is done, no unit.", "examples": [0.4]}
    )
    stage: str = field(metadata={"description": "Present stage of the work.", "examples": ["search"]})
    generation: int | None = field(
        default=None,
        metadata={"description": "Number of the search's generation. Null: no search is running.", "examples": [12]},
    )
    best_value: float | None = field(
        default=None,
        metadata={
            "description": "Best objective of the search, in the objective's own unit. Null: no search is running.",
            "examples": [0.013],
        },
    )
    seconds_left: float | None = field(
        default=None,
        metadata={
            "ge": 0,
            "description": "Seconds until a reconstruction ends, by its pace. Null: not known.",
            "examples": [40.0],
        },
    )


ProgressCallback = Callable[[Progress], None]
