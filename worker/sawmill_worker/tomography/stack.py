"""Whole logs: blocks of slices, several concurrently, in bounded memory."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from threading import Event

from numba import get_num_threads, set_num_threads
from numba.np.ufunc import threading_layer

# Numba's own layer of threads ends the process when it is entered twice.
CONCURRENT_LAYERS = {"omp", "tbb"}


def most_abreast() -> int:
    """How many blocks may be at work at a time: one a thread, if Numba's layer of threads can be entered twice."""
    set_num_threads(get_num_threads())  # the layer is chosen when it is first asked for something
    return get_num_threads() if threading_layer() in CONCURRENT_LAYERS else 1


def reconstruct_stack(
    slices: int,
    reconstruct: Callable[[int, int], Iterator[None]],
    *,
    step: int,
    abreast: int = 1,
    done: Callable[[int], None] | None = None,
) -> None:
    """Reconstruct slices 0..slices, `step` of them at a time.

    Parameters
    ----------
    reconstruct : callable
        Reads, computes and writes the slices start..stop, and yields in between: a block that nobody waits for any more
        is left there. Called in rising order; in threads where several are abreast.
    abreast : int
        How many blocks, at most `most_abreast`, are at work, and so in memory, at a time: one reads or writes while
        another computes, and none waits for another. A single one is reconstructed in the calling thread.
    done : callable, optional
        Told in the calling thread how many slices are done.

    Raises
    ------
    Exception
        Whatever `reconstruct` raises; no other block is begun then, and none that is at work goes on past its part.
    """
    blocks = [(start, min(start + step, slices)) for start in range(0, slices, step)]
    stopped = Event()

    def work_on(block: tuple[int, int]) -> None:
        for _ in reconstruct(*block):
            if stopped.is_set():
                return

    if abreast == 1:
        for block in blocks:
            work_on(block)
            if done is not None:
                done(block[1])
        return
    finished = 0
    threads = max(1, get_num_threads() // abreast)
    with ThreadPoolExecutor(abreast, initializer=set_num_threads, initargs=(threads,)) as pool:
        at_work = {pool.submit(work_on, block): block for block in blocks}
        try:
            for ended in as_completed(at_work):
                ended.result()
                start, stop = at_work[ended]
                finished += stop - start
                if done is not None:
                    done(finished)
        finally:
            stopped.set()
            for block_at_work in at_work:
                block_at_work.cancel()
