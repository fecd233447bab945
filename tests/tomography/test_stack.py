"""A stack in blocks: each slice once, with no more in memory than was promised."""

import threading
import time

import pytest

from sawmill_tomography.reconstruction import cost
from sawmill_tomography.reconstruction.stack import reconstruct_stack

SLICES = 40


@pytest.mark.parametrize("concurrent", [1, 3])
@pytest.mark.parametrize("step", [7, 16, 48])
def test_blocks_cover_the_whole_volume_and_one_at_a_time_they_are_in_order(step, concurrent):
    begun, reported, at_work, most = [], [], set(), []
    lock = threading.Lock()

    def reconstruct(start, stop):
        with lock:
            begun.append((start, stop))
            at_work.add(start)
            most.append(len(at_work))
        yield
        with lock:
            at_work.remove(start)

    reconstruct_stack(SLICES, reconstruct, step=step, concurrent=concurrent, done=reported.append)
    # Threads take blocks in order, but one may wait for the processor before it says so.
    in_order = begun if concurrent == 1 else sorted(begun)
    assert in_order == [(start, min(start + step, SLICES)) for start in range(0, SLICES, step)]
    assert reported == sorted(reported)
    assert reported[-1] == SLICES
    assert max(most) <= concurrent


def test_as_many_blocks_as_asked_for_are_at_work_at_a_time():
    # Each waits for the other two: with fewer at a time none would end, and the barrier breaks.
    together = threading.Barrier(3, timeout=120.0)

    def reconstruct(_start, _stop):
        yield together.wait()

    reconstruct_stack(30, reconstruct, step=5, concurrent=3)


@pytest.mark.parametrize("concurrent", [1, 2])
def test_trouble_in_a_block_comes_out_and_ends_the_work(concurrent):
    begun = []

    def failing(start, _stop):
        begun.append(start)
        time.sleep(0.001)
        if start >= 16:
            raise OSError("the disk went away")
        yield

    with pytest.raises(OSError, match="went away"):
        reconstruct_stack(160_000, failing, step=16, concurrent=concurrent)
    # Besides those at work, threads may have taken others before the trouble was known, but not all 10 000.
    assert len(begun) < 160_000 // 16


def test_a_block_that_nobody_waits_for_any_more_does_not_go_on():
    at_work, over, went_on = threading.Event(), threading.Event(), []

    def reconstruct(start, _stop):
        if start == 0:
            at_work.wait(120.0)
            raise OSError("the disk went away")
        at_work.set()
        # Parts without end, were it not left; the test's own end is far later than the trouble is known.
        while not over.wait(0.001):
            yield
        went_on.append(start)

    deadline = threading.Timer(120.0, over.set)
    deadline.start()
    with pytest.raises(OSError, match="went away"):
        reconstruct_stack(2, reconstruct, step=1, concurrent=2)
    deadline.cancel()
    assert went_on == []


def test_blocks_stay_within_their_memory_and_few_slices_are_shared_out():
    for views, cells, size in ((360, 768, 256), (1800, 2048, 1024), (90, 384, 128), (3600, 4096, 2048)):
        for threads in (1, 2, 16):
            step, concurrent = cost.blocks(views, cells, size, 2500, cost.MEMORY_BYTES, threads)
            assert concurrent <= threads
            needed = concurrent * cost.block_bytes(views, cells, size, step)
            assert (step, concurrent) == (1, 1) or needed <= cost.MEMORY_BYTES
    assert cost.blocks(360, 768, 256, 2500, cost.MEMORY_BYTES, 2) == (32, 2)
    assert cost.blocks(360, 768, 256, 2500, 1, 2) == (1, 1)
    assert cost.blocks(360, 768, 256, 64, cost.MEMORY_BYTES, 2) == (32, 2)
    assert cost.blocks(360, 768, 256, 33, cost.MEMORY_BYTES, 2) == (32, 2)
    # Fewer than a vector are one block, which all threads compute.
    assert cost.blocks(360, 768, 256, 7, cost.MEMORY_BYTES, 2) == (16, 1)


def test_seconds_grow_with_the_work_and_the_pace_corrects_them():
    whole = cost.seconds(360, 768, 256, 2500)
    assert 4.0 < 1000.0 * whole / 2500 < 8.0  # milliseconds a slice on the machine the model was fitted on
    assert whole - cost.SECONDS_A_STACK == pytest.approx(
        25.0 * (cost.seconds(360, 768, 256, 100) - cost.SECONDS_A_STACK)
    )
    assert cost.seconds_left(30.0, 1000, 2500) == pytest.approx(45.0)
