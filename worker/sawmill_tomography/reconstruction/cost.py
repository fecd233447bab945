"""The cost of a reconstruction, in seconds and memory, before it starts."""

# Slices in one vector of the kernels, and in one where there are only few.
LANES, FEW_LANES = 16, 4
# Memory for all concurrent blocks. Both: benchmarks/reconstruction_speed.py.
MEMORY_BYTES = 768 * 2**20
# A block of more slices takes more memory and is no faster.
MOST_SLICES = 32

# Fitted by `make bench-fbp` on two cores; docs/evidence/speed.md compares it with measured times.
SECONDS_A_STACK = 0.05
SECONDS_A_CELL = 8e-9
SECONDS_AN_UPDATE = 6.0e-11
SECONDS_A_PIXEL = 2.0e-8
# Time of a forward and an adjoint projection of one of 16 slices, for each ray and each pixel across, and of a
# descent's own step for each pixel, on two cores (`benchmarks/iterative.py` at 3ab7f653).
SECONDS_A_CROSSING = 1.14e-10
SECONDS_A_STEP_PIXEL = 8.0e-9


def seconds(views: int, cells: int, size: int, slices: int) -> float:
    """Return the seconds from rows to the volume's file: filtering by cells, back-projection by views and pixels.

    Parameters
    ----------
    views, cells, size, slices : int
        Views and cells of each sinogram, pixels along each side of a slice, number of slices.
    """
    pixels = size * size
    a_slice = SECONDS_A_CELL * views * cells + SECONDS_AN_UPDATE * views * pixels + SECONDS_A_PIXEL * pixels
    return SECONDS_A_STACK + slices * a_slice


def seconds_a_slice(views: int, cells: int, size: int) -> float:
    """Return the seconds for each further slice by filtered back-projection."""
    return seconds(views, cells, size, 1) - SECONDS_A_STACK


def seconds_left(elapsed: float, done: float, slices: int) -> float:
    """Predict the remaining seconds from the pace so far."""
    return elapsed / done * (slices - done)


def lanes_of(slices: int) -> int:
    """Round slices up to whole vectors, as the kernels keep them."""
    return FEW_LANES if slices <= FEW_LANES else -(-slices // LANES) * LANES


def block_bytes(views: int, cells: int, size: int, slices: int) -> int:
    """Return the memory of a block at work: its rows and a copy on reading, rows laid out, and its slices."""
    return 4 * (2 * slices * views * cells + lanes_of(slices) * views * (cells + 2) + slices * size * size)


def blocks(views: int, cells: int, size: int, slices: int, memory_bytes: int, threads: int) -> tuple[int, int]:
    """Return slices per block, in whole vectors where there are several, and the number of concurrent blocks.

    There is one block for each thread if there are enough slices, as long as all blocks fit into the memory.
    """
    vectors = -(-slices // LANES)
    counts = (*range(1, LANES), *range(LANES, MOST_SLICES + 1, LANES))
    for concurrent in range(min(threads, vectors), 0, -1):
        share = LANES * -(-vectors // concurrent)
        fitting = [n for n in counts if n <= share and concurrent * block_bytes(views, cells, size, n) <= memory_bytes]
        if fitting and (concurrent == 1 or fitting[-1] >= LANES):
            return fitting[-1], concurrent
    return 1, 1


def volume_bytes(size: int, slices: int) -> int:
    """Return the bytes of a volume of float32, before it is compressed."""
    return 4 * slices * size * size
