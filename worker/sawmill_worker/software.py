"""Identity of the software that computes: version, code on the disk, and libraries that affect numbers."""

import hashlib
import sys
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from sawmill_vocabulary.version import PACKAGES, VERSION

_DIGITS = 16
LIBRARIES = ("h5py", "numba", "numpy", "Pillow", "scikit-image", "scipy", "tifffile")


@cache
def software() -> str:
    """Return the version with the first digits of the SHA-256 of all modules of the product and of its libraries.

    The modules are read once in a process, which should be at the start, when they equal the modules that are loaded.
    """
    digest = hashlib.sha256(sys.version.encode())
    digest.update("".join(f"{name} {version(name)}\0" for name in LIBRARIES).encode())
    for package in code_folders():
        for path in sorted(package.rglob("*.py")):
            code = path.read_bytes()
            digest.update(f"{package.name}/{path.relative_to(package)}\0{len(code)}\0".encode() + code)
    return f"{VERSION}+{digest.hexdigest()[:_DIGITS]}"


def code_folders() -> list[Path]:
    """Find the folders of the product's packages."""
    specs = filter(None, map(find_spec, PACKAGES))
    return [Path(folder) for spec in specs for folder in spec.submodule_search_locations or ()]
