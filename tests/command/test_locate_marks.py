"""`sawmill simulate log --pairs` and `sawmill locate-marks`, as a user has them."""

import json
from pathlib import Path

import numpy as np
import pytest
from results import fixed_pairs_result

from sawmill_vocabulary import FixedPair

pytestmark = pytest.mark.slow

FOUR = Path(__file__).parents[2] / "examples/fixed-pairs.json"


@pytest.fixture(scope="module")
def passed(run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of three pairs of the example, their calibration, and a log's passage."""
    folder = tmp_path_factory.mktemp("log")
    pairs = json.loads(FOUR.read_text())["pairs"][:3]
    (folder / "three.json").write_text(json.dumps({"pairs": pairs}))
    once = ("--passages", 1, "--rows", 30, "--seed", 4)
    run("simulate", "log", "--pairs", folder / "three.json", *once, "-o", folder / "log.h5")
    about = fixed_pairs_result()["pairs"][0] | {"predicted_rms_mm": 0.02}
    known = fixed_pairs_result(pairs=[about | {"source_frame": vars(FixedPair(**pair).frame)} for pair in pairs])
    (folder / "known.json").write_text(json.dumps(known))
    return folder


def arguments(folder: Path, *last: Path) -> list[object]:
    """The files of the log, with the last ones replaced."""
    files = [*(folder / f"log-{number}.h5" for number in (1, 2, 3))][: 3 - len(last)]
    return ["locate-marks", folder / "three.json", folder / "known.json", *files, *last, "--data", "counts"]


def test_nails_are_where_the_simulation_says_and_the_aligned_scan_is_reconstructed(run, passed):
    aligned = passed / "aligned.h5"
    found = json.loads(run(*arguments(passed), "--aligned", aligned, "--json").stdout)
    [metal] = json.loads((passed / "log-marks.json").read_text())["passages"]
    off = np.linalg.norm(np.array([mark["place_mm"] for mark in found["marks"]])[:, None] - np.array(metal), axis=2)
    assert off.min(axis=1).max() < 1.0
    assert np.sort(off.min(axis=0))[3] < 1.0  # the fifth crosses another one in a picture
    said = " ".join(run(*arguments(passed)).stdout.split())
    assert "4 marks" in said
    assert "The pairs agree; mm, of each pair if it alone has moved: " in said
    flags = ("--geometry", aligned.with_suffix(".json"), "--method", "total_variation", "--rows", "14:16")
    size = ("--size", 32, "--field-mm", 320)
    made = run("reconstruct", aligned, "--data", "line-integrals", *flags, *size, "-o", passed / "volume.h5", "--json")
    assert json.loads(made.stdout)["shape"] == [2, 32, 32]


def test_files_that_are_no_log_of_these_pairs_are_refused_in_one_sentence(run, failure, passed, tmp_path):
    line = arguments(passed)
    assert failure(*line[:4], *line[6:])["detail"] == "the scanner has 3 pairs: give a file for each, not 1"
    twice = failure(*line[:6], *line[3:])["detail"]
    assert twice.endswith("there are 6 files, 3 pairs, and 3 calibrated ones")
    replacing = failure(*line, "--aligned", passed / "known.h5")
    assert replacing["detail"].startswith("the geometry of known.h5 would replace a file that is read")
    run("simulate", "log", "--pairs", passed / "three.json", "--rows", 3, "--passages", 1, "-o", tmp_path / "short.h5")
    short = failure(*arguments(passed, tmp_path / "short-3.h5"))
    assert short["detail"].startswith("pair 3 has (views, rows) = (1, 3), 2 mm apart")
    line[2] = passed / "three.json"
    assert "three.json is no answer of calibrate-pairs --json" in failure(*line)["detail"]
