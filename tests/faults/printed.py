"""The table of a run."""

from collections.abc import Sequence

from tests.faults.trials import Outcome

_COUNTS = ("jobs", "faults", "losses", "lost", "double", "unequal", "orphans")


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
