"""The embedded worker of a mill: `python -m sawmill_worker.poller`."""

import argparse
from collections.abc import Collection, Sequence

from sawmill_platform.workers import poller
from sawmill_platform.workers.poller import SHORT_IDLE_S
from sawmill_worker.program import MILL


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one embedded worker, set up by the environment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--watch-parent", action="store_true", help="look for a job at each byte on standard input, stop at its end"
    )
    parser.add_argument(
        "--short", action="store_true", help=f"take short jobs only, and end after {SHORT_IDLE_S:g} s without any"
    )
    options = parser.parse_args(arguments)
    poller.run(MILL, watch_parent=options.watch_parent, short_only=options.short)


def run(kinds: Collection[str], scanners: Collection[str]) -> None:
    """Run one worker, set up by the environment, for jobs of these kinds and of these scanners; empty: of all."""
    poller.run(MILL, kinds=kinds, groups=lambda store: store.scanners.ids_of(scanners))


if __name__ == "__main__":
    main()
