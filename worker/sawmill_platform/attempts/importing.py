"""Imports without Python's garbage collector, for modules that a process keeps for its whole life.

`python -m sawmill_platform.attempts.importing MODULE` imports a program of ours so, and runs its `main`.
"""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module

# Starts the module named after it. Nothing is imported from the folder in which the program is started.
PROGRAM = (sys.executable, "-P", "-m", "sawmill_platform.attempts.importing")
# Libraries import these if they are installed, and no program started here uses them: 8 MiB of a template.
UNUSED = ("rich", "coverage", "charset_normalizer")


@contextmanager
def importing() -> Iterator[None]:
    """Import without the collector, which takes a seventh of a service's start and finds no garbage then.

    Later the collector does not visit the imported objects either.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


if __name__ == "__main__":
    del sys.argv[0]
    for name in UNUSED:
        sys.modules[name] = None  # type: ignore[assignment]  # its import fails, as if it were not installed
    with importing():
        program = import_module(sys.argv[0])
    program.main()
