"""Whole logs: slices reconstructed a block at a time, read and written while it computes, in bounded memory."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from worker.tomography.fbp import Block

Slices = TypeVar("Slices")
ReadRows = Callable[[int, int], Block]


def reconstruct_stack(
    slices: int,
    read: ReadRows,
    solve: Callable[[Block], Slices],
    write: Callable[[int, Slices], None],
    *,
    step: int,
    done: Callable[[int], None] | None = None,
) -> None:
    """Reconstruct slices 0..slices, `step` of them at a time.

    While one block is computed the next one is read and the one before is written, each in a thread of its own: never
    are there more than two blocks of rows and two of slices.

    Parameters
    ----------
    read : callable
        Rows start..stop as (views, stop - start, detector) float32 line integrals.
    solve : callable
        Rows to slices, called in rising order.
    write : callable
        The first slice's number, and what `solve` gave. Called in rising order.
    done : callable, optional
        Told how many slices are written or handed over to be written.

    Raises
    ------
    Exception
        Whatever `read`, `solve` or `write` raise.
    """
    with ThreadPoolExecutor(1) as reading, ThreadPoolExecutor(1) as writing:
        coming = reading.submit(read, 0, min(step, slices))
        written: Future[None] | None = None
        for first in range(0, slices, step):
            stop = min(first + step, slices)
            rows = coming.result()
            if stop < slices:
                coming = reading.submit(read, stop, min(stop + step, slices))
            solved = solve(rows)
            if written is not None:
                written.result()
            written = writing.submit(write, first, solved)
            if done is not None:
                done(stop)
        if written is not None:
            written.result()
