"""Every study and every tool starts: modules are imported and arguments are parsed, all in one process."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
# Prints one line for each script that cannot be imported or does not describe its arguments.
PROGRAM = """
import contextlib, importlib, io, pathlib, sys

sys.path.insert(0, ".")
for path in sorted(pathlib.Path().glob("*.py")):
    described = io.StringIO()
    try:
        module = importlib.import_module(path.stem)
        if "ArgumentParser" in path.read_text():
            sys.argv = [path.name, "--help"]
            with contextlib.redirect_stdout(described):
                module.main()
            print(path.name, "goes on after --help")
    except SystemExit as ended:
        if ended.code or "usage:" not in described.getvalue():
            print(path.name, "ends with", ended.code)
    except Exception as error:
        print(path.name, repr(error))
"""


def test_every_script_is_imported_and_parses_its_arguments():
    command = [sys.executable, "-c", PROGRAM, ROOT / "benchmarks", ROOT / "docs/tools"]
    done = subprocess.run(command, cwd=ROOT / "benchmarks", capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
