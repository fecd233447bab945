"""Selection of rows and views of a scan."""

import numpy as np
from numpy.typing import NDArray

from sawmill_contracts.row_ranges import parse_rows
from sawmill_worker.use_cases.failures import refused


def chosen_rows(rows: str | None, available: int, usable: tuple[int, int] | None = None) -> slice:
    """Parse the rows A:B or A:B:STEP, or select all usable rows; refuse rows that the scan does not have.

    Parameters
    ----------
    usable : (first, one after the last), optional
        The rows that enough views have; all by default.
    """
    first, last = usable or (0, available)
    if rows is None:
        return slice(first, last)
    selected = parse_rows(rows)
    if selected.stop > available:
        raise refused("rows-outside", f"rows {rows} were asked for, but the scan has rows 0:{available}")
    if selected.start < first or selected.stop > last:
        raise refused(
            "rows-outside",
            f"rows {rows} were asked for, but too many views lost some of them: rows {first}:{last} can be used",
        )
    return selected


def chosen_views(views: int | None, available: int) -> NDArray[np.intp]:
    """Return indices of every (available / views)-th view, or of all views; refuse more views than available."""
    if views is None:
        return np.arange(available)
    if views > available:
        raise refused("views-too-many", f"{views} views were asked for, but the scan has {available}")
    return np.arange(views) * available // views
