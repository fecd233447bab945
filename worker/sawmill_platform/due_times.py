"""When a cron expression comes true in a time zone: every time in UTC, and on days of change as well each once.

An hour that the expression names is one of the wall clock. Where the clock jumps over it, it comes when the clock goes
on; where the clock goes back, it comes at the first of the two. Debian's cron does so, and CronSim after it, for hours
and minutes that begin with no star; here for all but `*` as the hour. Every hour means each hour that passes.
"""

from collections.abc import Iterator
from datetime import UTC, datetime
from functools import cache
from zoneinfo import ZoneInfo, available_timezones

from cronsim import CronSim, CronSimError

from sawmill_platform.errors import Invalid

_HOURS_OF_DAY = 24
# Of no place: what a machine is set to, and what stands in for nothing.
_NO_ZONES = frozenset({"localtime", "Factory"})


def next_due(cron: str, time_zone: str, after: datetime) -> datetime:
    """The first time of the expression after `after`.

    Raises
    ------
    Invalid
        It is no expression of five fields, never comes true, or there is no such time zone.
    """
    if time_zone not in _zones():
        msg = f"time_zone must be a name of the tz database, as Europe/Helsinki or UTC, not {time_zone!r}"
        raise Invalid("invalid-zone", msg)
    try:
        if len(cron.split()) == 5:  # cronsim would take a sixth, seconds
            return next(_times(cron, time_zone, after))
    except (CronSimError, StopIteration):
        pass
    msg = (
        "cron must be five fields, minute hour day month weekday, that come true at some time, "
        f"as in '30 5 * * 1-6', not {cron!r}"
    )
    raise Invalid("invalid-cron", msg)


def latest_due(cron: str, time_zone: str, now: datetime) -> datetime:
    """The last time of an expression that has one, up to and including `now`."""
    # Backwards, cronsim leaves out the very second it is given, and on a day of change perhaps an hour before it.
    wall = now.astimezone(ZoneInfo(time_zone)).replace(microsecond=1)
    latest = next(CronSim(_for_cronsim(cron), wall, reverse=True)).astimezone(UTC)
    for following in _times(cron, time_zone, latest):
        if following > now:
            break
        latest = following
    return latest


def _times(cron: str, time_zone: str, after: datetime) -> Iterator[datetime]:
    """All of them after `after`, the first one first."""
    wall = after.astimezone(ZoneInfo(time_zone))
    # In the hour that comes twice, cronsim begins with times of the first one.
    return (due for each in CronSim(_for_cronsim(cron), wall) if (due := each.astimezone(UTC)) > after)


def _for_cronsim(cron: str) -> str:
    """The expression with a star first in hours or minutes where it is for every hour, and only there."""
    minute, hour, *days = cron.split()
    if len(CronSim(cron, datetime.now(UTC)).hours) == _HOURS_OF_DAY:
        return " ".join((minute, "*", *days))
    return " ".join((minute.replace("*", "0-59"), hour.replace("*", "0-23"), *days))


@cache
def _zones() -> frozenset[str]:
    return frozenset(available_timezones()) - _NO_ZONES
