"""Growth of stored files, and the time until the disk is full under the rules of retention."""

from collections.abc import Iterable
from datetime import datetime, timedelta
from math import inf
from typing import NamedTuple

from sqlalchemy import func
from sqlalchemy.orm import Session

from sawmill_platform.contracts.retention import Limits
from sawmill_platform.retention.stocks import Stock

SEEN = timedelta(days=7)


class Growth(NamedTuple):
    """Growth of the stored files.

    Attributes
    ----------
    bytes_a_day : float
        Bytes added in a day, the mean of the last week.
    full_in_days : float or None
        Days until the disk is full at that rate. None: the rules prevent that, or nothing is added.
    """

    bytes_a_day: float
    full_in_days: float | None


class Filling(NamedTuple):
    """Growth of one kind, in bytes a day, and the number of bytes that the rules still allow to be added."""

    bytes_a_day: float
    up_to_bytes: float


def filling_of(session: Session, stock: Stock, limits: Limits, now: datetime) -> Filling:
    """Compute the growth of a kind that has files."""
    created_at = stock.table.created_at
    stored, oldest_at = session.execute(
        stock.select(stock.all_bytes, func.min(created_at), until=created_at <= now)
    ).one()
    came = session.scalar(stock.select(stock.all_bytes, until=created_at > now - SEEN)) or 0
    seen = SEEN if oldest_at is None else min(SEEN, max(timedelta(days=1), now - oldest_at))
    a_day = came / (seen / timedelta(days=1))
    days, most = limits
    limit = min(inf if days is None else a_day * days, inf if most is None else most)
    return Filling(a_day, max(0.0, limit - stored))


def growth_of(kinds: Iterable[Filling], free_bytes: float) -> Growth:
    """Compute the growth of all kinds together on one disk with this much free space."""
    growing = sorted((each for each in kinds if each.bytes_a_day > 0.0), key=_grows_for_days)
    total = sum(each.bytes_a_day for each in growing)
    at_days, a_day, remaining_bytes = 0.0, total, max(0.0, free_bytes)
    for each in growing:
        until_days = _grows_for_days(each)
        if remaining_bytes <= a_day * (until_days - at_days):
            return Growth(total, at_days + remaining_bytes / a_day)
        remaining_bytes -= a_day * (until_days - at_days)
        at_days, a_day = until_days, a_day - each.bytes_a_day
    return Growth(total, None)


def _grows_for_days(filling: Filling) -> float:
    return filling.up_to_bytes / filling.bytes_a_day
