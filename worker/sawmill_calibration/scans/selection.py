"""Selection of rows and views of a scan."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.failures import refused
from sawmill_contracts.row_ranges import parse_rows


def chosen_rows(rows: str | None, available: int, usable: tuple[int, int] | None = None) -> slice:
    """Parse rows A:B or A:B:STEP, or select all usable (first, after the last); refuse rows that the scan lacks."""
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


def chosen_views(views: int | None, available: int, left_out: Sequence[int] = ()) -> NDArray[np.intp]:
    """Return indices of every (usable / views)-th usable view, or of all of them; refuse more views than usable."""
    usable = np.setdiff1d(np.arange(available), left_out)
    if views is None:
        return usable
    if views > usable.size:
        corrupt = f" of which {len(left_out)} are corrupt" if left_out else ""
        raise refused("views-too-many", f"{views} views were asked for, but the scan has {available}{corrupt}")
    return usable[np.arange(views) * usable.size // views]
