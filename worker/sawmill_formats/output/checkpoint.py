"""Checkpoints: the progress of a long computation as arrays in a file, for an attempt that starts again.

A file is a seal (a mark, the checksum and the length of the rest) and an NPZ archive: the arrays, and as `origin` the
JSON of their input. A file that a kill or a power loss left incomplete does not match its seal.
"""

import json
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sawmill_platform.files.whole_files import whole_file

Arrays = Mapping[str, NDArray[Any]]

_SEAL = struct.Struct("<8sIQ")
_MARK = b"SAWKEPT1"
_ORIGIN = "origin"
_READ_BYTES = 2**20


class UnusableCheckpoint(Exception):  # noqa: N818 - an outcome's name, as in `files.errors`
    """A checkpoint that is damaged, or of another computation; the sentence tells which."""


def write_checkpoint(path: Path, origin: Mapping[str, Any], arrays: Arrays) -> None:
    """Write a checkpoint, whole or not at all.

    Parameters
    ----------
    origin : mapping
        JSON-able values that the arrays depend on.
    arrays : mapping
        Arrays of numbers; no name is `origin`.

    Raises
    ------
    OSError
        It cannot be written, as on a full disk; nothing is left behind.
    ValueError
        An array holds Python objects.
    """
    with whole_file(path) as file:
        file.write(bytes(_SEAL.size))
        np.savez(file, allow_pickle=False, **{_ORIGIN: _packed(origin)}, **arrays)
        length = file.tell() - _SEAL.size
        checksum = _checksum(file)
        file.seek(0)
        file.write(_SEAL.pack(_MARK, checksum, length))


def read_checkpoint(path: Path, origin: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Read the arrays of a checkpoint.

    Raises
    ------
    UnusableCheckpoint
        The file is damaged, or was computed from another origin.
    FileNotFoundError
        There is no file.
    """
    with path.open("rb") as file:
        head = file.read(_SEAL.size)
        if len(head) < _SEAL.size or head != _SEAL.pack(_MARK, _checksum(file), path.stat().st_size - _SEAL.size):
            raise UnusableCheckpoint("it is damaged")
        file.seek(_SEAL.size)
        with np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    made_from = json.loads(arrays.pop(_ORIGIN).tobytes())
    expected = json.loads(_packed(origin).tobytes())
    if made_from != expected:
        names = (made_from.keys() | expected.keys()) - {
            name for name in made_from if made_from[name] == expected.get(name)
        }
        raise UnusableCheckpoint(f"it was computed from another {', '.join(sorted(names))}")
    return arrays


def _packed(origin: Mapping[str, Any]) -> NDArray[np.uint8]:
    return np.frombuffer(json.dumps(origin).encode(), np.uint8)


def _checksum(file: BinaryIO) -> int:
    """Compute the checksum of all that follows the seal."""
    file.seek(_SEAL.size)
    checksum = 0
    while part := file.read(_READ_BYTES):
        checksum = zlib.crc32(part, checksum)
    return checksum
