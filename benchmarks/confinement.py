"""The cost of confining an attempt to its own files: processor time in a process forked for it, as attempts are.

python benchmarks/confinement.py [--times 50]
"""

import argparse
import os
import statistics
import tempfile
import time
from pathlib import Path

from sawmill_contracts.handed_over import HandedOver
from sawmill_platform.confinement import landlock
from sawmill_platform.confinement.confinement import confine_to, installation, move_into


def once(folder: Path) -> float:
    """Return the milliseconds of a child that is confined to a folder."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        start_s = time.thread_time()
        move_into(folder / "work")
        confine_to(HandedOver(kept=folder / "kept"), folder)
        os.write(writing, repr(1e3 * (time.thread_time() - start_s)).encode())
        os._exit(0)
    os.close(writing)
    os.waitpid(child, 0)
    with open(reading) as reported:  # noqa: PTH123 - a descriptor, not a path
        return float(reported.read())


def main() -> None:
    """Measure it and print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=50)
    times = parser.parse_args().times
    installation()
    with tempfile.TemporaryDirectory() as parent:
        taken_ms = [once(Path(tempfile.mkdtemp(dir=parent))) for _ in range(times)]
    print(f"Landlock {landlock.version()}: {statistics.median(taken_ms):.1f} ms, at most {max(taken_ms):.1f} ms")


if __name__ == "__main__":
    main()
