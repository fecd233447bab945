"""A trial on a small disk: in a separate process, in a mount namespace that ends with the process.

`python -m tests.faults.small_disk` is that process: it reads what is to be tried as JSON, and prints the outcome.
"""

import json
import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

from tests.faults.catalogue import ENGINES, FAULTS
from tests.faults.trials import Outcome, Places, Request, try_one

DISK_MIB = 64
_OWN_MOUNTS = ["unshare", "--map-root-user", "--mount", "sh", "-c"]
_MOUNT = f'mkdir -p "$0" && mount -t tmpfs -o size={DISK_MIB}m tmpfs "$0"'
_ROOT = Path(__file__).parents[2]


def try_there(folder: Path, request: Request, right: dict[str, str]) -> Outcome:
    """Run `trials.try_one` with the data folder on a small disk."""
    names = request.engine.name, request.fault.name
    data = folder / f"{request.engine.name}-{request.fault.name}" / "data"
    tried = subprocess.run([*_OWN_MOUNTS, _MOUNT, str(data)], capture_output=True, text=True, check=False)
    if tried.returncode:
        return Outcome(*names, skipped=f"no disk can be mounted here: {tried.stderr.strip()}")
    given = {"names": names, "jobs": request.jobs, "seed": request.seed, "folder": str(folder), "right": right}
    done = subprocess.run(
        [*_OWN_MOUNTS, f'{_MOUNT} && exec "$@"', str(data), sys.executable, "-m", "tests.faults.small_disk"],
        input=json.dumps({**given, "mix": list(request.mix), "long": request.long}),
        stdout=subprocess.PIPE,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": f"{_ROOT}:{os.environ.get('PYTHONPATH', '')}"},
    )
    if done.returncode:
        return Outcome(*names, broken=f"the process on the small disk ended with {done.returncode}")
    return Outcome.of(json.loads(done.stdout))


def main() -> None:
    """Run the trial that standard input requests."""
    given = json.load(sys.stdin)
    engine = next(engine for engine in ENGINES if engine.name == given["names"][0])
    fault = next(fault for fault in FAULTS if fault.name == given["names"][1])
    request = Request(engine, fault, given["jobs"], given["seed"], given["mix"], given["long"])
    with ExitStack() as stack:
        places = Places(Path(given["folder"]), stack)
        print(json.dumps(try_one(places, request, given["right"], lambda: None).as_json()))


if __name__ == "__main__":
    main()
