"""Long jobs that are ended again and again, and go on where they were: on a real store, in this process."""

from dataclasses import replace
from itertools import count
from typing import Any

import h5py
import numpy as np
import pytest
from structlog.testing import capture_logs

from sawmill_contracts.calibrations import PaperOptions
from sawmill_vocabulary import CalibrationMethod
from sawmill_worker.jobs import checkpoints
from sawmill_worker.jobs.attempt import MillAttempt
from sawmill_worker.jobs.checkpoints import (
    PAUSE_S,
    AttemptKeeper,
    UnusableCheckpoint,
    read_checkpoint,
    write_checkpoint,
)
from sawmill_worker.jobs.running import run

pytestmark = pytest.mark.slow

# Times are no part of an answer.
NOT_COMPARED = {"timing_s", "time_s"}


class Killed(Exception):  # noqa: N818 - what happened to it
    pass


def hours_go_by(job: MillAttempt) -> MillAttempt:
    """An attempt for which a second goes by at each look at the clock: a checkpoint every few evaluations."""
    return replace(job, monotonic=map(float, count()).__next__)


def run_killed(store, tmp_path, first: MillAttempt, announcements: int) -> tuple[dict[str, Any], int]:
    """Run a job; each attempt dies at an announcement of its progress, after a number of others."""
    for number in range(1, 200):
        output = tmp_path / f"killed-{first.job.id}-{number}"
        output.mkdir()
        left = iter(range(announcements))

        def announce(names, output=output, left=left):
            store.files.keep(output, first.job.id, names)
            if next(left, None) is None:
                raise Killed

        job = first.job.model_copy(update={"attempt": number + 1})
        try:
            return run(replace(first, job=job, output=output, announce=announce)), number - 1
        except Killed:
            continue
    raise AssertionError("it made no progress")


def same(one, other):
    assert one | dict.fromkeys(NOT_COMPARED) == other | dict.fromkeys(NOT_COMPARED)


@pytest.fixture
def search(ingested, calibrating, sinogram, turn):
    scan = ingested(sinogram(turn(20))[:, None], "9:18")
    paper = PaperOptions(image_size=32, max_generations=1)
    return lambda: calibrating(scan, method=CalibrationMethod.PAPER, paper=paper, rows="0:1")


def test_a_published_search_killed_again_and_again_finds_the_same_theta(search, store, tmp_path):
    job = hours_go_by(search())
    whole = run(job)
    result, deaths = run_killed(store, tmp_path, job, 4)
    assert deaths > 3
    same(result, whole)


def test_a_short_job_keeps_nothing(search):
    announced = []
    job = replace(search(), monotonic=lambda: 0.0)
    run(replace(job, announce=announced.append))
    assert announced == []
    assert not job.checkpoints.exists()


@pytest.mark.parametrize("damage", ["truncated", "another scanner", "another version"])
def test_progress_that_does_not_fit_is_passed_over(search, store, spec, monkeypatch, damage):
    job = hours_go_by(search())

    def die(names):
        store.files.keep(job.output, job.job.id, names)
        raise Killed

    with pytest.raises(Killed):
        run(replace(job, announce=die))
    path = store.files.kept_with(job.job.id) / "search"
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:-7])
    elif damage == "another version":
        monkeypatch.setattr(checkpoints, "software", lambda: "0.0.1")
    else:
        constants = replace(store.scanners.get("line-2").constants, source_to_cor_mm=900.0)
        store.scanners.update("line-2", spec().model_copy(update={"constants": constants}))
    with capture_logs() as log:
        run(replace(job, given=store.jobs.handed_over(job.job.id), announce=lambda _: None))
    assert ("checkpoint-passed-over", "search") in [(line["event"], line.get("name")) for line in log]


def volume(ingested, reconstructing, sinogram, turn, theta, rows: int, **options: Any) -> MillAttempt:
    """Ask for a volume of a log that is dense here and thin there, with noise."""
    stack = sinogram(turn(20))[:, None] * np.linspace(0.5, 1.5, rows)[:, None]
    stack += 0.5 * np.random.default_rng(1216).standard_normal(stack.shape)
    return reconstructing(ingested(stack, "9:18"), theta=theta, size=32, field_mm=420.0, **options)


def everything_in(path):
    """Every dataset of a file but those that tell of times."""
    found = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return {name: value for name, value in found.items() if not name.endswith(("date", "_time"))}


# Blocks of 16 slices, two at a time; and one after another, with a weight and a coupling that are chosen once.
@pytest.mark.parametrize(
    ("method", "rows", "options"),
    [
        ("fbp", 100, {}),
        ("total_variation", 57, {}),
        pytest.param("total_variation", 33, {"coupling": "none"}, marks=pytest.mark.nightly),
        pytest.param("tikhonov", 33, {}, marks=pytest.mark.nightly),
    ],
)
def test_a_volume_killed_again_and_again_has_the_same_values(
    ingested, reconstructing, sinogram, turn, theta, store, tmp_path, method, rows, options
):
    job = hours_go_by(volume(ingested, reconstructing, sinogram, turn, theta, rows, method=method, **options))
    whole = run(job)
    result, deaths = run_killed(store, tmp_path, job, 0)
    assert deaths > 1
    same(result, whole)
    (made,) = tmp_path.glob(f"killed-*-{deaths + 1}/volume.h5")
    right, found = everything_in(job.output / "volume.h5"), everything_in(made)
    assert right.keys() == found.keys()
    for name in right:
        np.testing.assert_array_equal(found[name], right[name], err_msg=name)


def test_blocks_that_are_damaged_are_made_again(ingested, reconstructing, sinogram, turn, theta, store, tmp_path):
    job = hours_go_by(volume(ingested, reconstructing, sinogram, turn, theta, 150, method="fbp"))
    whole = run(job)
    folder = store.files.kept_with(job.job.id)
    announced = []

    def take(names):
        store.files.keep(job.output, job.job.id, names)
        announced.extend(names)

    run(replace(job, announce=take))
    for number, path in enumerate(sorted(folder.glob("slices-*"))):
        path.write_bytes(path.read_bytes()[: -1 - number])
    result, _ = run_killed(store, tmp_path, job, 100)
    same(result, whole)


def test_checkpoints_leave_room_for_the_volume(ingested, reconstructing, sinogram, turn, theta, full_disk):
    job = hours_go_by(volume(ingested, reconstructing, sinogram, turn, theta, 150, method="fbp"))
    full_disk(150 * 32 * 32 * 4)
    announced = []
    assert run(replace(job, announce=announced.append))["shape"] == [150, 32, 32]
    assert announced == []


def test_a_full_disk_is_logged_once_and_tried_again_after_the_pause(search, full_disk):
    now, announced = [0.0], []
    keeper = AttemptKeeper(replace(search(), announce=announced.extend, monotonic=lambda: now[0]), {})

    def keep_when_due(name):
        now[0] += PAUSE_S
        assert keeper.is_due
        keeper.keep(name, {"numbers": np.arange(3)})
        assert not keeper.is_due

    full_disk(0)
    with capture_logs() as log:
        keep_when_due("first")
        keep_when_due("second")
        full_disk(10**9)
        keep_when_due("third")
        full_disk(0)
        keep_when_due("fourth")
    left_out = [(line["event"], line["name"]) for line in log]
    assert left_out == [("checkpoint-left-out", "first"), ("checkpoint-left-out", "fourth")]
    assert announced == ["third"]


ORIGIN = {"input_sha256": "ab" * 32, "options": {"seed": 7, "rows": (3, 9)}, "software_version": "1.0"}
ARRAYS = {"values": np.array([0.1, np.pi, -np.inf]), "images": np.arange(24, dtype=np.float32).reshape(2, 3, 4)}


@pytest.fixture
def path(tmp_path):
    write_checkpoint(tmp_path / "search", ORIGIN, ARRAYS)
    return tmp_path / "search"


def test_arrays_come_back_bit_for_bit_and_alone(path):
    read = read_checkpoint(path, ORIGIN)
    assert list(read) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert read[name].dtype == array.dtype
        np.testing.assert_array_equal(read[name], array)
    assert [file.name for file in path.parent.iterdir()] == ["search"], "nothing half-written"


def test_a_damaged_checkpoint_is_recognised(path):
    whole = path.read_bytes()
    rng = np.random.default_rng(1215)
    damaged = [whole[:length] for length in (0, 5, 24, len(whole) // 2, len(whole) - 1)]
    damaged += [whole + b"\0", bytes(len(whole))]
    for place in rng.integers(len(whole), size=200):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << rng.integers(8)
        damaged.append(bytes(flipped))
    for content in damaged:
        path.write_bytes(content)
        with pytest.raises(UnusableCheckpoint, match="damaged"):
            read_checkpoint(path, ORIGIN)


def test_a_checkpoint_of_another_computation_is_recognised(path):
    with pytest.raises(UnusableCheckpoint, match=r"another input_sha256, software_version$"):
        read_checkpoint(path, {**ORIGIN, "input_sha256": "cd" * 32, "software_version": "1.1"})
    with pytest.raises(FileNotFoundError):
        read_checkpoint(path.with_name("other"), ORIGIN)


def test_objects_are_refused_and_leave_nothing(tmp_path):
    with pytest.raises(ValueError, match="allow_pickle"):
        write_checkpoint(tmp_path / "search", ORIGIN, {"values": np.array([{}])})
    assert list(tmp_path.iterdir()) == []
