"""The bytes and the elements of one variable in a MATLAB file of version 5.

Layout: The MathWorks, "MAT-File Format", chapter 1 (level 5).
"""

import struct
import zlib
from dataclasses import dataclass
from typing import BinaryIO

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.arrays import HARMLESS_BYTES, LARGEST_RATIO

TAG_BYTES = 8
SMALL_DATA_BYTES = 4
PIECE_BYTES = 2**20


@dataclass(frozen=True)
class Element:
    """A tag of an element: the stored type, the number of bytes, and their number with padding."""

    type: int
    data_bytes: int
    padded_bytes: int


class VariableStream:
    """A variable, unpacked if it is packed, read forwards; never more in memory than the file stores."""

    def __init__(self, file: BinaryIO, stored_bytes: int, *, packed: bool, order: str, most_bytes: int) -> None:
        self.order = order
        self.position = 0
        declared = max(HARMLESS_BYTES, LARGEST_RATIO * stored_bytes)
        self._file, self._left, self._most = file, stored_bytes, min(most_bytes, declared) if packed else most_bytes
        self._inflater = zlib.decompressobj() if packed else None

    def element(self) -> Element:
        """Read the next tag; a small element contains its data, which come next."""
        word, *_ = struct.unpack(f"{self.order}I", self.read(4))
        if word >> 16:
            return Element(word & 0xFFFF, word >> 16, SMALL_DATA_BYTES)
        length, *_ = struct.unpack(f"{self.order}I", self.read(4))
        return Element(word, length, -(-length // TAG_BYTES) * TAG_BYTES)

    def data(self, element: Element) -> bytearray:
        """Read the data of the element whose tag was read last, and skip the padding."""
        if element.data_bytes > element.padded_bytes:
            raise ValueError(f"an element of {SMALL_DATA_BYTES} bytes claims {element.data_bytes}")
        end = self.position + element.padded_bytes
        data = self.read(element.data_bytes)
        self.skip_to(end)
        return data

    def read(self, length: int) -> bytearray:
        """Read this number of bytes; EOFError where there are fewer."""
        data = bytearray()
        while len(data) < length:
            data += self._piece(min(length - len(data), PIECE_BYTES))
        return data

    def skip_to(self, position: int) -> None:
        """Read on to a later position without keeping anything."""
        if position < self.position:
            raise ValueError("a part of a variable is longer than the whole")
        while self.position < position:
            self._piece(min(position - self.position, PIECE_BYTES))

    def check_end(self) -> None:
        """Unpack the rest of a packed variable, whose checksum is at its end."""
        while self._inflater is not None and not self._inflater.eof:
            self._piece(PIECE_BYTES, required=False)

    def _piece(self, most: int, *, required: bool = True) -> bytes:
        piece = self._stored(most) if self._inflater is None else self._unpacked(self._inflater, most)
        ended = self._inflater is not None and self._inflater.eof
        if not piece and (required or not ended):
            raise EOFError("a variable ends before its data do")
        self.position += len(piece)
        if self.position > self._most:
            raise UnreadableScan(
                "too-large",
                f"a variable unpacks to more than the {self._most} bytes that are allowed or free, or 200 times "
                "what is stored of it",
            )
        return piece

    def _unpacked(self, inflater: "zlib._Decompress", most: int) -> bytes:
        while not inflater.eof:
            stored = inflater.unconsumed_tail or self._stored(PIECE_BYTES)
            piece = inflater.decompress(stored, most)
            if piece or not stored:
                return piece
        return b""

    def _stored(self, most: int) -> bytes:
        piece = self._file.read(min(most, self._left))
        self._left -= len(piece)
        return piece
