"""Checkpoints: what was written comes back, and what a kill left behind does not."""

import numpy as np
import pytest

from sawmill_worker.jobs.checkpoints import UnusableCheckpoint, read_checkpoint, write_checkpoint

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
