"""The job service works without anything of a mill."""

import json
import re
import subprocess
import sys
from pathlib import Path

import sawmill_platform

# Names of the product that clients, services and disks know: packages, variables, the command, queues, files and keys.
PRODUCT = re.compile(r'sawmill[_.-]\w*|"sawmill"|sawmill (serve|restore)', re.IGNORECASE)
MILL = re.compile(r"scanner|\bscans?\b|phantom|calibrat|reconstruct|inspection|tomogra|mills?\b|board", re.IGNORECASE)


def test_a_dummy_kind_of_job_runs_on_the_platform_alone(tmp_path):
    program = Path(__file__).with_name("dummy_kind.py")
    done = subprocess.run([sys.executable, program, tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])
    assert seen["states"] == ["succeeded", "failed"]
    assert seen["answers"] == {"good": [{"total": 6}, None], "empty": [None, "there is nothing to add"]}
    assert seen["events"] == ["queued", "queued", "started", "succeeded", "started", "failed"]
    assert seen["packages"] == ["sawmill_platform", "sawmill_vocabulary"]


def test_the_platform_names_nothing_of_a_mill():
    folder = Path(sawmill_platform.__file__).parent
    assert [
        f"{path.relative_to(folder)}:{number}: {line.strip()}"
        for path in folder.rglob("*.py")
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if MILL.search(PRODUCT.sub("", line))
    ] == []
