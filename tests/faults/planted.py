"""Defects planted by hand, one in each room: each must be found by the tests that are named with it.

    python tests/faults/planted.py [--only FILE ...]

Each defect is planted in a copy of the working tree, in which its tests run; a quarter of an hour for all. The exit
code is 1 unless all are found.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("benchmarks", "docs", "examples", "installation", "openapi", "service", "tests", "worker")


class Defect(NamedTuple):
    """A defect: in this file of the product the old text, which occurs once, becomes the new one."""

    file: str
    old: str
    new: str
    tests: str

    def place(self, root: Path) -> Path:
        """Find the one file of this name that has the old text."""
        named = [path for top in ("worker", "service") for path in (root / top).rglob(self.file)]
        (place,) = (path for path in named if path.read_text().count(self.old) == 1)
        return place

    def test_files(self, root: Path) -> list[Path]:
        """Find the files of tests that must fail."""
        return [next((root / "tests").rglob(name)) for name in self.tests.split()]


DEFECTS = (
    Defect("wait_estimate.py", "groups.c.priority, last_turn,", "groups.c.priority,", "test_queue.py"),
    Defect("patience.py", "seconds >= self._lease_s", "seconds >= 2.0 * self._lease_s", "test_patience.py"),
    Defect("landlock.py", "_checked(_call(RESTRICT_SELF, ruleset", "(_call(RESTRICT_SELF, -1", "test_confinement.py"),
    Defect("verified_results.py", " or outcome[0] != identity", "", "store/test_files.py"),
    Defect("key_store.py", "return row.revoked_at is None and (", "return (", "store/test_keys.py"),
    Defect("events.py", "EventRow.number > number, published()", "published()", "store/test_events.py"),
    Defect("outbox.py", "attempt_at = False, True", "attempt_at = row.enabled, True", "test_webhook_delivery.py"),
    Defect("upload_parts.py", "not in {None, sha256}", "== sha256[::-1]", "service/test_uploads.py"),
    Defect("tiff/pages.py", "= {2, 3}, {3, 4}, 4", "= {2}, {3, 4}, 4", "test_tiff.py"),
    Defect("nxtomo.py", "keys, nxtomo.FLAT", "keys, nxtomo.DARK", "test_reading.py"),
    Defect("image_names.py", "(0, int(part)", "(0, len(part)", "test_image_names.py"),
    Defect("detector_shape.py", "dtype=np.float64) + 0.5 -", "dtype=np.float64) -", "test_geometry.py"),
    Defect("projector.py", "quarters = -self.quarter_turn", "quarters = self.quarter_turn", "test_projector.py"),
    Defect("fbp.py", "kernel[0] = 0.25 / pitch_mm**2", "kernel[0] = 0.26 / pitch_mm**2", "test_fbp.py"),
    Defect("descent.py", "[active] < tolerance *", "[active] < 1e3 * tolerance *", "test_coarse_to_fine.py"),
    Defect("phantom.py", "_mapped(1.0, -1.0, 0.0", "_mapped(-1.0, 1.0, 0.0", "tomography/test_phantom.py"),
    Defect("search/search.py", "PEAKS = 4", "PEAKS = 0", "test_ambiguity.py"),
    Defect("normal_equations.py", "[:, :, own] + precisions\n", "[:, :, own]\n", "test_normal_equations.py"),
    Defect("judgement.py", "predicted.upper_95_mm <=", "predicted.rms_mm <=", "test_judgement.py"),
    Defect("change.py", "CHANCE_OF_A_JUMP = 30.0", "CHANCE_OF_A_JUMP = 3000.0", "test_log_movement.py"),
    Defect("metal_bodies.py", "exact = least - np.log(", "exact = least + np.log(", "tomography/test_metal.py"),
    Defect("activations.py", "Row.number.desc()).limit(1)", "Row.number).limit(1)", "test_history.py"),
    Defect("scanner_state.py", "and check.log_came_at > check.phantom_came_at\n", "\n", "mill/test_automatic.py"),
    Defect("calibrations.py", 'ACTIVATE,\n    summary="Make a', 'READ,\n    summary="Make a', "service/test_keys.py"),
    Defect("lists.py", "midnight(day + _ONE_DAY)", "midnight(day)", "service/test_scans_page.py"),
    Defect("export.py", "result.rotation.apply(np", "(np", "test_simulate_and_export.py"),
)


def tests_pass(copy: Path, tests: Iterable[Path]) -> bool:
    command = [sys.executable, "-m", "pytest", "--numprocesses", "0", "--quiet", "--exitfirst", *map(str, tests)]
    environment = {**os.environ, "PYTHONPATH": f"{copy}/service:{copy}/worker"}
    done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
    if done.returncode not in {0, 1}:
        sys.exit(f"the tests did not run: {done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    return done.returncode == 0


def is_found(defect: Defect, copy: Path) -> bool:
    """Plant a defect in the copy, run its tests, and take it out again."""
    place = defect.place(copy)
    sound = place.read_text()
    place.write_text(sound.replace(defect.old, defect.new))
    try:
        return not tests_pass(copy, defect.test_files(copy))
    finally:
        place.write_text(sound)


def main() -> int:
    """Plant the defects one after another; print which are found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    files = [defect.file for defect in DEFECTS]
    parser.add_argument("--only", nargs="+", choices=files, default=files, metavar="FILE", help=", ".join(files))
    only = parser.parse_args().only
    chosen, missed = [defect for defect in DEFECTS if defect.file in only], 0
    with tempfile.TemporaryDirectory(prefix="sawmill-planted-") as folder:
        copy = Path(folder) / "copy"
        for name in COPIED:  # with the times of the files, by which compiled kernels are found to be theirs
            shutil.copytree(ROOT / name, copy / name, symlinks=True)
        for file in ("pyproject.toml", "README.md", "CHANGELOG.md", "constraints.txt", "docker-compose.yml"):
            shutil.copy2(ROOT / file, copy / file)
        if not tests_pass(copy, {path: None for defect in chosen for path in defect.test_files(copy)}):
            sys.exit("a test fails without any defect")
        for defect in chosen:
            found = is_found(defect, copy)
            missed += not found
            print(f"{defect.file:24} {'found' if found else 'NOT FOUND'}", flush=True)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
