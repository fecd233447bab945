"""Which software computes: its version, its code as it lies on the disk, and the libraries that numbers come from."""

import hashlib
import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path

from sawmill_worker.vocabulary.version import VERSION

_PACKAGE = Path(__file__).parents[1]
_DIGITS = 16
LIBRARIES = ("h5py", "numba", "numpy", "Pillow", "scikit-image", "scipy", "tifffile")


@cache
def software() -> str:
    """The version, and the first digits of the SHA-256 of all modules of `sawmill_worker` and of what they need.

    Read once a process, which should be at its start: the modules that it has loaded are those of that time.
    """
    digest = hashlib.sha256(sys.version.encode())
    digest.update("".join(f"{name} {version(name)}\0" for name in LIBRARIES).encode())
    for path in sorted(_PACKAGE.rglob("*.py")):
        code = path.read_bytes()
        digest.update(f"{path.relative_to(_PACKAGE)}\0{len(code)}\0".encode() + code)
    return f"{VERSION}+{digest.hexdigest()[:_DIGITS]}"
