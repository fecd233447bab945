"""The job service works without anything of a mill."""

import json
import subprocess
import sys
from pathlib import Path


def test_a_dummy_kind_of_job_runs_on_the_platform_alone(tmp_path):
    program = Path(__file__).with_name("dummy_kind.py")
    done = subprocess.run([sys.executable, program, tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])
    assert seen["states"] == ["succeeded", "failed"]
    assert seen["answers"] == {"good": [{"total": 6}, None], "empty": [None, "there is nothing to add"]}
    assert seen["events"] == ["queued", "queued", "started", "succeeded", "started", "failed"]
    assert seen["packages"] == ["sawmill_platform", "sawmill_vocabulary"]
