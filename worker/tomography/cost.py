"""What a reconstruction by filtered back-projection costs: seconds and memory, before it is begun."""

from worker.tomography.fbp import LANES, lanes_of

MEMORY_BYTES = 768 * 2**20
# More slices a block bring nothing: the cells under a tile would leave the second-level cache.
MOST_SLICES = 64

# Fitted by `make bench-fbp` on two cores; docs/performance.md has the fit beside the machine's limits.
SECONDS_A_STACK = 0.05
SECONDS_A_CELL = 7e-9
SECONDS_AN_UPDATE = 8.7e-11
SECONDS_A_PIXEL = 1.7e-8


def seconds(views: int, cells: int, size: int, slices: int) -> float:
    """Seconds from rows to the volume's file: filtering goes by the cell, back-projection by the view and pixel.

    Parameters
    ----------
    views, cells, size, slices : int
        Of each sinogram, of each side of a slice, and how many slices.
    """
    pixels = size * size
    a_slice = SECONDS_A_CELL * views * cells + SECONDS_AN_UPDATE * views * pixels + SECONDS_A_PIXEL * pixels
    return SECONDS_A_STACK + slices * a_slice


def seconds_left(elapsed: float, done: float, slices: int) -> float:
    """By the pace so far; `seconds` foretells until there is one."""
    return elapsed / done * (slices - done)


def block_bytes(views: int, cells: int, size: int, slices: int) -> int:
    """Memory at work: rows of two blocks and a copy on reading, rows laid out, slices and those being written."""
    rows = 3 * slices * views * cells + lanes_of(slices) * views * (cells + 2)
    return 4 * (rows + 2 * slices * size * size)


def slices_a_block(views: int, cells: int, size: int, memory_bytes: int | None = None) -> int:
    """The most slices, in whole vectors where there are several, whose block stays within the memory; at least one."""
    limit = MEMORY_BYTES if memory_bytes is None else memory_bytes
    counts = (*range(1, LANES), *range(LANES, MOST_SLICES + 1, LANES))
    fitting = [n for n in counts if block_bytes(views, cells, size, n) <= limit]
    return max(fitting, default=1)


def volume_bytes(size: int, slices: int) -> int:
    """A volume of float32, before it is compressed."""
    return 4 * slices * size * size
