"""Unpacking of LZF data, which writes no more than the destination holds.

A byte below 32 is followed by as many literals and one more; any other one repeats (its upper three bits, and the
next byte where they are 7) + 2 bytes from as far back as its lower five bits and the next byte tell (M. Lehmann,
LibLZF, lzf_d.c).

Of PackBits data the bytes are only counted: a byte below 128 is followed by as many literals and one more; one above
128 repeats the next byte 257 - n times (Adobe, "TIFF Revision 6.0", section 9).
"""

from numba import njit


@njit(cache=True)
def unpack_lzf(packed, unpacked):
    """Unpack LZF data into `unpacked`; return the number of bytes, more than its size where they do not fit, or -1."""
    at, to = 0, 0
    while at < packed.size:
        token = int(packed[at])
        at += 1
        if token < 32:
            length = token + 1
            if at + length > packed.size:
                return -1
            if to + length > unpacked.size:
                return to + length
            for offset in range(length):
                unpacked[to + offset] = packed[at + offset]
            at += length
        else:
            length = token >> 5
            if length == 7:
                if at >= packed.size:
                    return -1
                length += int(packed[at])
                at += 1
            length += 2
            if at >= packed.size:
                return -1
            start = to - (((token & 31) << 8) | int(packed[at])) - 1
            at += 1
            if start < 0:
                return -1
            if to + length > unpacked.size:
                return to + length
            for offset in range(length):
                unpacked[to + offset] = unpacked[start + offset]
        to += length
    return to


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
