"""Several processes that do the same at once, of one interpreter: to import takes far longer than what they do."""

import subprocess
import sys

# Each child writes what it printed when it ends, in one piece: a pipe takes 4096 bytes at once.
SCRIPT = """
import os, sys
{imports}
children = []
for _ in range({count}):
    child = os.fork()
    if not child:
        break
    children.append(child)
else:
    sys.exit(any([os.waitpid(child, 0)[1] for child in children]))
sys.stdout = open(1, "w", buffering=4096, closefd=False)
{program}
"""


def race(count: int, imports: str, program: str) -> str:
    """What `count` processes of a program print, together."""
    script = SCRIPT.format(imports=imports, count=count, program=program)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout
