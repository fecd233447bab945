"""Which rows and views of a scan are used."""

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.contracts.base import parse_rows
from sawmill_worker.use_cases.failures import refused


def chosen_rows(rows: str | None, available: int) -> slice:
    """The rows A:B or A:B:STEP, or all of them; refused where the scan has no such rows."""
    if rows is None:
        return slice(0, available)
    selected = parse_rows(rows)
    if selected.stop > available:
        raise refused("rows-outside", f"rows {rows} were asked for, but the scan has rows 0:{available}")
    return selected


def chosen_views(views: int | None, available: int) -> NDArray[np.intp]:
    """Indices of every (available / views)-th view, or of all; refused where there are fewer."""
    if views is None:
        return np.arange(available)
    if views > available:
        raise refused("views-too-many", f"{views} views were asked for, but the scan has {available}")
    return np.arange(views) * available // views
