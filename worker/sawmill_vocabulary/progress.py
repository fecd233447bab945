"""How far a running job is: the one type of progress."""

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Progress:
    """How far a running job is."""

    fraction: float = field(
        metadata={"ge": 0, "le": 1, "description": "Share that is done, no unit.", "examples": [0.4]}
    )
    stage: str = field(metadata={"description": "What it does now.", "examples": ["search"]})
    generation: int | None = field(
        default=None,
        metadata={"description": "Number of the search's generation. Null: it has none.", "examples": [12]},
    )
    best_value: float | None = field(
        default=None,
        metadata={
            "description": "Best objective of the search so far, in its own unit. Null: there is none.",
            "examples": [0.013],
        },
    )
    seconds_left: float | None = field(
        default=None,
        metadata={
            "ge": 0,
            "description": "Seconds until a reconstruction ends, by its pace so far. Null: not known.",
            "examples": [40.0],
        },
    )


ProgressCallback = Callable[[Progress], None]
