"""Number of bytes that packed data unpack to. The kernels only count, and store nothing.

PackBits: a byte below 128 is followed by as many literals and one more; one above 128 repeats the next byte 257 - n
times (Adobe, "TIFF Revision 6.0", section 9).
"""

from numba import njit


@njit(cache=True)
def packbits_bytes(packed, most):
    """Count the bytes that PackBits data unpack to; counting ends where there are more than `most`."""
    at, unpacked = 0, 0
    while at < packed.size and unpacked <= most:
        token = packed[at]
        at += 1
        if token < 128:
            at += token + 1
            unpacked += token + 1
        elif token > 128:
            at += 1
            unpacked += 257 - token
    return unpacked
