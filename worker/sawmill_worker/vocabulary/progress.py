"""How far a running job is: the one type of progress."""

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Progress:
    """How far a running job is."""

    fraction: float = field(metadata={"ge": 0, "le": 1})
    stage: str = field(metadata={"examples": ["search"]})
    generation: int | None = field(default=None, metadata={"description": "Of the search."})
    best_value: float | None = field(default=None, metadata={"description": "Best objective of the search so far."})
    seconds_left: float | None = field(
        default=None, metadata={"ge": 0, "description": "Of a reconstruction, by its pace so far."}
    )


ProgressCallback = Callable[[Progress], None]
