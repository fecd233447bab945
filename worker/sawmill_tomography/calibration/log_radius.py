"""The disc in which ray errors are counted: the largest log's or, where none is given, the phantom's."""

from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_vocabulary import LARGEST_ASSUMED_LOG_RADIUS_MM, GeometryError, Scanner


def refuse_log_beyond_source(stated_mm: float | None, scanner: Scanner) -> None:
    """Refuse a radius of the largest log that would hold the source.

    Raises
    ------
    GeometryError
        If the radius is as large as the distance of the source from the COR, or larger.
    """
    if stated_mm is not None and stated_mm >= scanner.source_to_cor_mm:
        raise GeometryError(
            f"log_radius_mm {stated_mm:g} must be less than source_to_cor_mm {scanner.source_to_cor_mm:g}: no log "
            "holds the source"
        )


def counted_radius_mm(stated_mm: float | None, seen: Phantom) -> float:
    """Return the radius of the disc around the COR in which ray errors are counted.

    docs/look-up/conventions.md#ray-error defines it.
    """
    return min(LARGEST_ASSUMED_LOG_RADIUS_MM, seen.radius_mm) if stated_mm is None else stated_mm
