"""The disc in which ray errors are counted: the largest log's, or where nobody stated one, the phantom's."""

from sawmill_worker.tomography.phantom import Phantom
from sawmill_worker.vocabulary import LARGEST_ASSUMED_LOG_RADIUS_MM


def counted_radius_mm(stated_mm: float | None, seen: Phantom) -> float:
    """Radius of the disc around the COR in which ray errors are counted (docs/conventions.md#ray-error).

    Parameters
    ----------
    stated_mm : float or None
        Of the largest log, where somebody stated it.
    seen : Phantom
        As it stands in the scanner. What it never reached it says little about.
    """
    return min(LARGEST_ASSUMED_LOG_RADIUS_MM, seen.radius_mm) if stated_mm is None else stated_mm
