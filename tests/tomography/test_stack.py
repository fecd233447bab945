"""A stack in blocks: the same slices, in order, with no more in memory than was promised."""

from functools import partial

import numpy as np
import pytest

from worker.tomography import cost
from worker.tomography.fbp import fbp_block
from worker.tomography.geometry import FanBeamGeometry, Scanner
from worker.tomography.image_grid import ImageGrid
from worker.tomography.projector import Projector
from worker.tomography.stack import reconstruct_stack

VIEWS, CELLS, SIZE, SLICES = 12, 64, 32, 40


@pytest.fixture
def projector(theta, full_turn):
    scanner = Scanner(source_to_cor_mm=859.46, num_detector_pixels=CELLS, detector_pitch_mm=18.0)
    return Projector(FanBeamGeometry(scanner, theta, full_turn(VIEWS)), ImageGrid(SIZE, 400.0))


@pytest.fixture
def stack():
    return np.random.default_rng(711).standard_normal((VIEWS, SLICES, CELLS)).astype(np.float32)


@pytest.mark.parametrize("block", [7, 16, 48])
def test_blocks_make_the_whole_volume_in_order_and_read_one_block_ahead(projector, stack, block):
    read, told = [], []
    volume = np.full((SLICES, SIZE, SIZE), np.nan, np.float32)

    def reading(start, stop):
        # Never farther than the block after the one that is computed.
        assert start <= (told[-1] if told else 0) + block
        read.append((start, stop))
        return stack[:, start:stop]

    def writing(first, slices):
        assert not np.isnan(volume[:first]).any()
        volume[first : first + len(slices)] = slices

    reconstruct_stack(SLICES, reading, partial(fbp_block, projector), writing, step=block, done=told.append)
    # Blocks and slices by themselves differ by single precision.
    np.testing.assert_allclose(volume, fbp_block(projector, stack), atol=1e-4 * np.abs(volume).max())
    assert told[-1] == SLICES
    assert [stop for _, stop in read] == told
    assert max(stop - start for start, stop in read) == min(block, SLICES)


def test_trouble_in_reading_or_writing_comes_out(projector, stack):
    written = []

    def failing(start, stop):
        if start >= 32:
            raise OSError("the disk went away")
        return stack[:, start:stop]

    solve = partial(fbp_block, projector)
    with pytest.raises(OSError, match="went away"):
        reconstruct_stack(SLICES, failing, solve, lambda first, _: written.append(first), step=16)
    assert written == [0, 16]

    def full(_first, _slices):
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="is full"):
        reconstruct_stack(SLICES, lambda a, b: stack[:, a:b], solve, full, step=16)


def test_blocks_stay_within_their_memory():
    for views, cells, size in ((360, 768, 256), (1800, 2048, 1024), (90, 384, 128), (3600, 4096, 2048)):
        slices = cost.slices_a_block(views, cells, size)
        assert slices == 1 or cost.block_bytes(views, cells, size, slices) <= cost.MEMORY_BYTES
    assert cost.slices_a_block(360, 768, 256) == 64
    assert cost.slices_a_block(360, 768, 256, memory_bytes=1) == 1


def test_seconds_grow_with_the_work_and_the_pace_corrects_them():
    whole = cost.seconds(360, 768, 256, 2500)
    assert 4.0 < 1000.0 * whole / 2500 < 8.0  # milliseconds a slice on the machine the model was fitted on
    assert whole - cost.SECONDS_A_STACK == pytest.approx(
        25.0 * (cost.seconds(360, 768, 256, 100) - cost.SECONDS_A_STACK)
    )
    assert cost.seconds_left(30.0, 1000, 2500) == pytest.approx(45.0)
