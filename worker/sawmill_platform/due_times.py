"""Due times of a cron expression in a time zone: each time in UTC, once, also on days when the clock changes.

An hour that the expression names is an hour of the wall clock. If the clock jumps over the hour, the time is due when
the clock continues; if the clock goes back, at the first of the two hours. Debian's cron and CronSim do so for hours
and minutes that do not begin with a star; this module does so for all expressions except `*` as the hour. Every hour
means each hour that passes.
"""

from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from zoneinfo import ZoneInfo, available_timezones

from cronsim import CronSim, CronSimError

from sawmill_platform.errors import Invalid

_HOURS_OF_DAY = 24
# Names of no place: a machine's own setting, and a placeholder.
_NO_ZONES = frozenset({"localtime", "Factory"})


def next_due(cron: str, time_zone: str, after: datetime) -> datetime:
    """Return the first time of the expression after `after`.

    Raises
    ------
    Invalid
        The expression does not have five fields or never comes true, or there is no such time zone.
    """
    if time_zone not in time_zones():
        msg = f"time_zone must be a name of the tz database, as Europe/Helsinki or UTC, not {time_zone!r}"
        raise Invalid("invalid-zone", msg)
    with suppress(CronSimError, StopIteration):
        if len(cron.split()) == 5:  # cronsim would take a sixth, seconds
            return next(_times(cron, time_zone, after))
    msg = (
        "cron must be five fields, minute hour day month weekday, that come true at some time, "
        f"as in '30 5 * * 1-6', not {cron!r}"
    )
    raise Invalid("invalid-cron", msg)


def latest_due(cron: str, time_zone: str, now: datetime) -> datetime:
    """Return the last time, up to and including `now`, of an expression that has one."""
    # Backwards, cronsim leaves out the second at which it starts, and on a day of change perhaps an hour before it.
    wall = now.astimezone(ZoneInfo(time_zone)).replace(microsecond=1)
    latest = next(CronSim(_for_cronsim(cron), wall, reverse=True)).astimezone(UTC)
    for following in _times(cron, time_zone, latest):
        if following > now:
            break
        latest = following
    return latest


def _times(cron: str, time_zone: str, after: datetime) -> Iterator[datetime]:
    """Return an iterator over all due times after `after`, in ascending order."""
    wall = after.astimezone(ZoneInfo(time_zone))
    # In the hour that comes twice, cronsim begins with times of the first hour.
    return (due for each in CronSim(_for_cronsim(cron), wall) if (due := each.astimezone(UTC)) > after)


def _for_cronsim(cron: str) -> str:
    """Return the expression for CronSim: a star first in hours or minutes only if it means every hour."""
    minute, hour, *days = cron.split()
    if len(CronSim(cron, datetime.now(UTC)).hours) == _HOURS_OF_DAY:
        return " ".join((minute, "*", *days))
    return " ".join((minute.replace("*", "0-59"), hour.replace("*", "0-23"), *days))


@cache
def time_zones() -> frozenset[str]:
    """Return the names of the time zones that this machine knows."""
    return frozenset(available_timezones()) - _NO_ZONES
