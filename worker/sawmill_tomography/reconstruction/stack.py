"""Whole logs: blocks of slices, several concurrently, in bounded memory."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from threading import Event

from numba import get_num_threads, set_num_threads
from numba.np.ufunc import threading_layer

# Numba's own threading layer, workqueue, ends the process when it is entered twice.
CONCURRENT_LAYERS = {"omp", "tbb"}


def most_concurrent() -> int:
    """Return how many blocks may run concurrently: one a thread, if Numba's threading layer can be entered twice."""
    set_num_threads(get_num_threads())  # the layer is chosen at the first call of this kind
    return get_num_threads() if threading_layer() in CONCURRENT_LAYERS else 1


def reconstruct_stack(
    slices: int,
    reconstruct: Callable[[int, int], Iterator[None]],
    *,
    step: int,
    concurrent: int = 1,
    done: Callable[[int], None] | None = None,
) -> None:
    """Reconstruct slices 0..slices, `step` of them at a time.

    Parameters
    ----------
    reconstruct : callable
        Reads, computes and writes the slices start..stop, and yields in between: a block that is no longer needed
        stops there. Called in rising order; in threads where blocks are concurrent.
    concurrent : int
        Number of blocks, at most `most_concurrent`, that run and are in memory at the same time: one reads or
        writes while another computes, and no block waits for another. With 1, blocks run in the calling thread.
    done : callable, optional
        Called in the calling thread with the number of slices that are done.

    Raises
    ------
    Exception
        Any exception of `reconstruct`; then no other block starts, and running blocks stop at their next yield.
    """
    blocks = [(start, min(start + step, slices)) for start in range(0, slices, step)]
    stopped = Event()

    def work_on(block: tuple[int, int]) -> None:
        for _ in reconstruct(*block):
            if stopped.is_set():
                return

    if concurrent == 1:
        for block in blocks:
            work_on(block)
            if done is not None:
                done(block[1])
        return
    finished = 0
    threads = max(1, get_num_threads() // concurrent)
    with ThreadPoolExecutor(concurrent, initializer=set_num_threads, initargs=(threads,)) as pool:
        running = {pool.submit(work_on, block): block for block in blocks}
        try:
            for ended in as_completed(running):
                ended.result()
                start, stop = running[ended]
                finished += stop - start
                if done is not None:
                    done(finished)
        finally:
            stopped.set()
            for unfinished in running:
                unfinished.cancel()
