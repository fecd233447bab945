"""Limits of rules of retention, by the names of their fields."""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple


class Limits(NamedTuple):
    """Limits of one kind.

    Attributes
    ----------
    days : int or None
        Number of days for which objects are kept. None: for good.
    most_bytes : int or None
        Bytes that the objects may have together. None: there is no rule, or the kind has no files.
    """

    days: int | None
    most_bytes: int | None


def rule_name(kind: str, unit: Literal["days", "bytes"]) -> str:
    """Return the field that has a kind's rule."""
    return f"{kind.replace('-', '_')}_{unit}"


def limits_of(rules: Mapping[str, Any], kind: str) -> Limits:
    """Return the limits of a kind under rules by the names of their fields."""
    return Limits(rules.get(rule_name(kind, "days")), rules.get(rule_name(kind, "bytes")))
