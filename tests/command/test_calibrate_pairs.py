"""`sawmill simulate --pairs` and `sawmill calibrate-pairs`, as a user has them."""

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from fixed_pairs import pair_ray_error
from pydantic import TypeAdapter
from recorded_apart import recorded_apart

from sawmill_contracts.fixed_pairs import FixedPairsResult
from sawmill_tomography.geometry.geometry import to_vector
from sawmill_tomography.pairs.ray_errors import PairRays
from sawmill_vocabulary import PairedScanner

pytestmark = pytest.mark.slow

FOUR = Path(__file__).parents[2] / "examples/fixed-pairs.json"
BOARD = ("--data", "counts", "--phantom", "l-shape")
LAID = ("--rows", 20, "--places-off-mm", 20)


def files(first: Path, pairs: int) -> list[Path]:
    return [first.with_name(f"{first.stem}-{number}.h5") for number in range(1, pairs + 1)]


def rays_off_mm(result: FixedPairsResult, true: Path) -> float:
    scanner = TypeAdapter(PairedScanner).validate_json(true.read_text())
    frames = np.array([to_vector(pair.frame) for pair in scanner.pairs])
    found = np.array([to_vector(pair.source_frame) for pair in result.pairs])
    rays = PairRays([pair.scanner for pair in scanner.pairs], frames, result.log_radius_mm)
    return pair_ray_error(rays, found).rms_mm


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pairs of the example, with half as many cells."""
    path = tmp_path_factory.mktemp("pairs") / "two.json"
    fewer = {"num_detector_pixels": 384, "detector_pitch_mm": 2.4}
    path.write_text(json.dumps({"pairs": [pair | fewer for pair in json.loads(FOUR.read_text())["pairs"][::2]]}))
    return path


@pytest.fixture(scope="module")
def passed(run, two) -> list[Path]:
    """Two passages through the two pairs."""
    run("simulate", "l-shape", "--pairs", two, *LAID, "--passages", 2, "-o", two.with_name("board.h5"))
    return files(two.with_name("board.h5"), 2)


def test_a_simulated_scanner_of_four_pairs_is_calibrated_as_it_truly_stands(run, tmp_path):
    run("simulate", "l-shape", "--pairs", FOUR, "--passages", 2, *LAID, "-o", tmp_path / "board.h5")
    answer = run("calibrate-pairs", FOUR, *files(tmp_path / "board.h5", 4), *BOARD, "--json").stdout
    result = FixedPairsResult.model_validate_json(answer)
    assert (result.verdict, result.reasons, result.phantom) == ("pass", [], "L-shape")
    assert rays_off_mm(result, tmp_path / "board-true.json") < result.upper_95_mm < result.options.tolerance_mm
    assert result.rows == [(1, 19)] * 4


def with_dead_cells(run, two: Path, path: Path, passages: int) -> list[Path]:
    """Simulate passages through two detectors, each with three cells that are dead since the flat fields."""
    path.with_name("physics.json").write_text('{"detector": {"dead_cells": 3}}')
    flags = (*LAID, "--passages", passages, "--physics", path.with_name("physics.json"), "--seed", 3)
    run("simulate", "l-shape", "--pairs", two, *flags, "-o", path)
    with h5py.File(files(path, 1)[0]) as file:
        detector = file["entry/instrument/detector"]
        shown = detector["data"][()][detector["image_key"][()] == 0]
    assert (shown == shown.min()).all(axis=(0, 1)).sum() == 3
    return files(path, 2)


def test_one_passage_is_watched_with_the_remedy_and_dead_cells_do_no_harm(run, two, tmp_path):
    scans = with_dead_cells(run, two, tmp_path / "dead.h5", 1)
    result = FixedPairsResult.model_validate_json(run("calibrate-pairs", two, *scans, *BOARD, "--json").stdout)
    assert rays_off_mm(result, tmp_path / "dead-true.json") < result.upper_95_mm < 0.5
    assert result.verdict == "watch"
    assert "Roll the board by about a quarter of a turn and pass it again" in result.reasons[0]


def test_the_table_of_two_passages_passes_and_dead_cells_do_no_harm(run, two, tmp_path):
    scans = with_dead_cells(run, two, tmp_path / "dead.h5", 2)
    assert "2 pairs with L-shape: pass" in " ".join(run("calibrate-pairs", two, *scans, *BOARD).stdout.split())


def test_passages_that_were_recorded_apart_are_calibrated_as_those_in_one_file(run, two, passed, tmp_path):
    together = json.loads(run("calibrate-pairs", two, *passed, *BOARD, "--json").stdout)
    found = json.loads(run("calibrate-pairs", two, *recorded_apart(passed, tmp_path), *BOARD, "--json").stdout)
    assert [pair["source_frame"]["psi_rad"] for pair in found["pairs"]] == pytest.approx(
        [pair["source_frame"]["psi_rad"] for pair in together["pairs"]], abs=3e-4
    )
    assert (len(found["passages"]), found["verdict"]) == (2, together["verdict"])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda pairs: {"pairs": pairs[:1]}, "no scanner of fixed pairs: pairs: Tuple should have at least 2 items"),
        (
            lambda pairs: {"pairs": pairs, "speed": 3},
            "no scanner of fixed pairs: speed: Extra inputs are not permitted",
        ),
        (
            lambda pairs: {"pairs": [pairs[0], pairs[1] | {"num_detector_pixels": 300}]},
            "pair 2 has 384 cells in its scan, and num_detector_pixels is 300",
        ),
    ],
)
def test_a_scanner_that_cannot_be_is_refused_in_one_sentence(failure, two, passed, change, sentence):
    path = two.with_name("changed.json")
    path.write_text(json.dumps(change(json.loads(two.read_text())["pairs"])))
    refusal = failure("calibrate-pairs", path, *passed, *BOARD)
    assert sentence in refusal["detail"]
    assert "\n" not in refusal["detail"]


def test_files_that_do_not_belong_together_are_refused(run, failure, two, passed, tmp_path):
    one = failure("calibrate-pairs", two, passed[0], *BOARD)
    assert one["detail"] == "the scanner has 2 pairs: give a file for each, not 1"
    run("simulate", "l-shape", "--pairs", two, "--rows", 2, "--passages", 1, "-o", tmp_path / "once.h5")
    other = failure("calibrate-pairs", two, passed[0], tmp_path / "once-2.h5", *BOARD)
    assert other["detail"] == "pair 2 has 1 passages in its file, and pair 1 has 2"
    (tmp_path / "letter.h5").write_text("this is no scan")
    letter = failure("calibrate-pairs", two, *passed, passed[0], tmp_path / "letter.h5", *BOARD)
    assert letter["detail"].startswith("pair 2, passage 2: ")
    few = tmp_path / "few.json"
    few.write_text(two.read_text().replace('"num_detector_pixels": 384', '"num_detector_pixels": 30'))
    for pairs, views, sentence in (
        (two, np.tile(np.hanning(384), (60, 1)), "pair 1 has 60 views in its file, and a calibration takes at most 12"),
        (two, np.ones((1, 384)), "pair 1: no row shows anything but air"),
        (few, np.hanning(30)[None], "pair 1 has 30 cells, and at least 32 are needed"),
    ):
        np.save(tmp_path / "lines.npy", views)
        scans = [tmp_path / "lines.npy"] * 2
        refusal = failure("calibrate-pairs", pairs, *scans, *BOARD[2:], "--data", "line-integrals")
        assert refusal["detail"].startswith(sentence)
    assert one["code"] == other["code"] == "contradiction"


def test_a_passage_of_air_is_refused(failure, two, passed, tmp_path):
    air = Path(shutil.copy(passed[1], tmp_path / "air.h5"))
    with h5py.File(air, "r+") as file:
        detector = file["entry/instrument/detector"]
        frames, key = detector["data"][()], detector["image_key"][()]
        level = frames[key == 1].mean(axis=0)
        frames[key == 0] = np.random.default_rng(1).poisson(level, frames[key == 0].shape)
        detector["data"][...] = frames
    refusal = failure("calibrate-pairs", two, passed[0], air, *BOARD)
    assert refusal["detail"].startswith("pair 2 sees nothing of the board in one of its passages")


def test_passages_of_a_log_with_a_phantom_and_a_turning_scan_too_are_wrong_use(wrong_use, two, tmp_path):
    of = ("--pairs", two, "-o", tmp_path / "out.h5")
    assert "--pairs passes a phantom or a log" in wrong_use("simulate", "log-with-phantom", "--rows", 9, *of)
    assert "one of them, not both" in wrong_use("simulate", "l-shape", *of, "--theta", "0,700,0,0,0")
    assert "'--theta' or '--pairs'" in wrong_use("simulate", "l-shape", "-o", tmp_path / "out.h5")
