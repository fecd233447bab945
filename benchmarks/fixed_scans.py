"""Sixty scans of the mill study whose answers are committed: a change for speed alone leaves them as they are.

    python benchmarks/fixed_scans.py [--write] [--jobs 2]

`fixed_scans.json` names them by their numbers in `mill_scans.py` with seed 1, with the answer to each. Exit code 1
where a verdict, a refusal or a hypothesis is another one, or where a number of the geometry moved by more than a tenth
of its standard deviation. `--write` keeps the answers of this commit as those to compare with. Half a minute.
The geometry is theta as (psi, R, SDD, u_c, tau), whose deviations are known where the source shift's is not.
"""

import argparse
import json
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numba
import numpy as np
from mill_scans import StudyScan

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.refusals import CalibrationError
from sawmill_tomography.geometry.geometry import to_vector

ANSWERS = Path(__file__).with_suffix(".json")
SEED = 1
# Allowed change, in standard deviations.
ALLOWED = 0.1
SAID = ("refused", "verdict", "rays_verdict", "handedness", "rotation")

Answer = dict[str, Any]


def answer(number: int) -> Answer:
    """Return a scan's answer: the refusal's code, or verdicts, hypothesis, geometry and its deviations."""
    try:
        found = calibrate(StudyScan.of(number, SEED).task(), seed=number)
    except CalibrationError as error:
        return {"refused": error.code}
    assert found.findings.error_bars is not None
    return {
        "verdict": found.judgement.verdict,
        "rays_verdict": found.judgement.rays_verdict,
        "handedness": found.handedness,
        "rotation": found.rotation,
        "geometry": to_vector(found.frame).tolist(),
        "deviations": found.findings.error_bars.frame_deviation(found.frame)[:5].tolist(),
    }


def moved(before: Answer, now: Answer) -> float:
    """Return the largest change of a number of the geometry, in standard deviations."""
    change, deviations = np.abs(np.subtract(now["geometry"], before["geometry"])), np.array(before["deviations"])
    change[0] = abs(math.remainder(change[0], math.tau))
    known = deviations > 0.0
    return float((change[known] / deviations[known]).max())


def answers(numbers: list[int], jobs: int) -> dict[str, Answer]:
    """Calibrate each scan with one thread."""
    with ProcessPoolExecutor(jobs, initializer=numba.set_num_threads, initargs=(1,)) as pool:
        found = pool.map(answer, numbers)
        return {str(number): said for number, said in zip(numbers, found, strict=True)}


def differences(before: dict[str, Answer], now: dict[str, Answer]) -> list[str]:
    """List what differs between two runs, a line each."""
    lines = []
    for number, old in before.items():
        new = now[number]
        said = ((name, old.get(name), new.get(name)) for name in SAID)
        lines += [f"scan {number}: {name} {was} is {became}" for name, was, became in said if was != became]
        if "geometry" in old and "geometry" in new and (by := moved(old, new)) > ALLOWED:
            lines.append(f"scan {number}: the geometry moved by {by:.2f} standard deviations")
    return lines


def main() -> None:
    """Compare, or write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="keep these answers")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    before: dict[str, Answer] = json.loads(ANSWERS.read_text())
    now = answers([int(number) for number in before], options.jobs)
    if options.write:
        lines = [f"{json.dumps(number)}: {json.dumps(said)}" for number, said in now.items()]
        ANSWERS.write_text("{\n" + ",\n".join(lines) + "\n}\n")
        return
    lines = differences(before, now)
    both = [(old, now[number]) for number, old in before.items() if "geometry" in old and "geometry" in now[number]]
    most = max(moved(*pair) for pair in both)
    print("\n".join(lines))
    print(f"{len(before)} scans, {len(lines)} differences; the geometry moved by {most:.1e} deviations at most.")
    sys.exit(1 if lines else 0)


if __name__ == "__main__":
    main()
