"""Python's garbage collector rests while a process imports what it keeps as long as it lives.

`python -m sawmill_platform.attempts.importing MODULE` imports a program of ours so, and runs its `main`.
"""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module

# Starts what the name of a module follows. Nothing is imported from the folder in which it happens to be started.
PROGRAM = (sys.executable, "-P", "-m", "sawmill_platform.attempts.importing")
# Libraries import these where they are installed, and nothing that is started so ever uses them: 8 MiB of a template.
UNUSED = ("rich", "coverage", "charset_normalizer")


@contextmanager
def importing() -> Iterator[None]:
    """Import without the collector, which takes a seventh of a service's start and finds nothing then.

    Later it does not look at what has been imported either.
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
