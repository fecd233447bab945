"""Other processes: one that holds SQLite's write lock, and several of one interpreter that do the same at once."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

HOLDER = """
import sqlite3, sys
connection = sqlite3.connect(sys.argv[1], isolation_level=None)
connection.execute("BEGIN IMMEDIATE")
print("held", flush=True)
sys.stdin.read()
connection.execute("ROLLBACK")
"""


@contextmanager
def write_lock(database: Path) -> Iterator[None]:
    command = [sys.executable, "-c", HOLDER, str(database)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout.readline() == b"held\n"
        yield
        holder.stdin.close()
        holder.wait()


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
