"""No job is lost: real services and servers under faults, and a count of what they did to the jobs.

    python -m tests.faults.inject_faults [--jobs 500] [--seed 1] [--only FAULT ...] [--engine ENGINE ...] [--long]

Every trial starts the product again on one engine, requests tiny jobs of five kinds over HTTP, half of them plans, and
makes one class of faults while they run. At the end it counts, by separate triggers in the database and by what lies in
the data folder: jobs that were accepted and did not succeed (lost), jobs that ended and results that were published
more than once (double), answers and arrays that differ from a run without faults (unequal), and files that no row knows
(orphans). Leases are 4 s. The exit code is 1 unless all are 0.
"""

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.faults.trials import ENGINES, FAULTS, Outcome, Plan, conduct_all

_COUNTS = ("jobs", "faults", "losses", "lost", "double", "unequal", "orphans")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names, engines = [fault.name for fault in FAULTS], [engine.name for engine in ENGINES]
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="FAULT", help=", ".join(names))
    parser.add_argument(
        "--engine", nargs="+", choices=engines, default=engines, metavar="ENGINE", help=", ".join(engines)
    )
    parser.add_argument("--jobs", type=int, help="of all trials together: 500, or 2000 with --long")
    parser.add_argument("--seed", type=int, default=1, help="of what happens when, and to whom")
    parser.add_argument("--long", action="store_true", help="2000 jobs, and Redis away for ten minutes: an hour")
    parser.add_argument("--keep", type=Path, help="folder for data and logs, kept")
    options = parser.parse_args()
    plan = Plan(
        [fault for fault in FAULTS if fault.name in options.only],
        [engine for engine in ENGINES if engine.name in options.engine],
        jobs=options.jobs or (2000 if options.long else 500),
        seed=options.seed,
        long=options.long,
        folder=options.keep,
    )
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that what was started is ended too
    outcomes: list[Outcome] = []
    try:
        for outcome in conduct_all(plan):
            outcomes.append(outcome)  # noqa: PERF402 - so that they are there if the next is interrupted
    finally:  # an interrupted run prints what it has
        print_table(outcomes, plan.seed)
    sys.exit(0 if all(outcome.sound for outcome in outcomes) else 1)


def print_table(outcomes: Sequence[Outcome], seed: int) -> None:
    """Print a line a trial, the sums, and a sentence for every fault that was found."""
    print(f"seed {seed}")
    print(f"{'engine':<20} {'fault':<11}" + "".join(f"{name:>9}" for name in _COUNTS) + f"{'s':>6}  what happened")
    for outcome in outcomes:
        print(f"{outcome.engine:<20} {outcome.fault:<11}" + _figures(outcome))
    sums = [sum(getattr(outcome.counts, name) for outcome in outcomes if outcome.counts) for name in _COUNTS]
    seconds = sum(outcome.counts.seconds for outcome in outcomes if outcome.counts)
    print(f"{'all':<32}" + "".join(f"{number:>9}" for number in sums) + f"{seconds:>6.0f}")
    for outcome in outcomes:
        for sentence in outcome.counts.details if outcome.counts else outcome.broken.splitlines():
            print(f"{outcome.engine} {outcome.fault}: {sentence}")


def _figures(outcome: Outcome) -> str:
    if outcome.counts is None:
        return f"  skipped: {outcome.skipped}" if outcome.skipped else "  broke down, see below"
    counts = outcome.counts
    happened = ", ".join(f"{what} {times}" for what, times in sorted(outcome.happened.items()))
    return "".join(f"{getattr(counts, name):>9}" for name in _COUNTS) + f"{counts.seconds:>6.0f}  {happened}"


if __name__ == "__main__":
    main()
