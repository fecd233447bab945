"""Limits of rules of retention, by the names of their fields."""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple


class Limits(NamedTuple):
    """Days for which objects of a kind are kept, and bytes that they may have together; None: there is no rule."""

    days: int | None
    most_bytes: int | None


def rule_name(kind: str, unit: Literal["days", "bytes"]) -> str:
    """Return the field that has a kind's rule."""
    return f"{kind.replace('-', '_')}_{unit}"


def limits_of(rules: Mapping[str, Any], kind: str) -> Limits:
    """Return the limits of a kind under rules by the names of their fields."""
    return Limits(rules.get(rule_name(kind, "days")), rules.get(rule_name(kind, "bytes")))
