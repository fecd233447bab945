"""Several services on one database: each due time runs once, and none is left out."""

import time
from datetime import UTC, datetime

from sqlalchemy import text
from tests.faults.trial import Trial

SCHEDULES = 4
LATEST_S = 150.0  # two minutes, and what a slow machine needs


def begin(trial: Trial) -> None:
    """Create schedules that are due every minute, each for a scanner with a new scan."""
    for number in range(SCHEDULES):
        trial.asker.schedule(f"line {number}", "* * * * *")


def finish(trial: Trial) -> None:
    """Wait until each has run at two due times; then no time between the first and the last may be missing."""
    deadline = time.monotonic() + LATEST_S
    while any(len(times) < 2 for times in _runs(trial).values()) and time.monotonic() < deadline:
        time.sleep(1.0)
    for schedule, times in _runs(trial).items():
        minutes = sorted(round(moment.timestamp() / 60) for moment in times)
        if len(minutes) < 2 or minutes != list(range(minutes[0], minutes[-1] + 1)):
            trial.wrong.append(f"schedule {schedule} ran at {[str(moment) for moment in times]}")
        trial.seen["due times"] += len(minutes)


def _runs(trial: Trial) -> dict[str, list[datetime]]:
    with trial.audit.reading() as connection:
        found: dict[str, list[datetime]] = {
            row.id: [] for row in connection.execute(text("SELECT id FROM schedules")).all()
        }
        for row in connection.execute(text("SELECT schedule_id, due_at FROM schedule_runs ORDER BY due_at")).all():
            due = datetime.fromisoformat(row.due_at) if isinstance(row.due_at, str) else row.due_at
            found[row.schedule_id].append(due if due.tzinfo else due.replace(tzinfo=UTC))
    return found
