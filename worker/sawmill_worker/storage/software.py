"""Which software computes: its version, and its code as it lies on the disk, which changes without a version."""

import hashlib
from functools import cache
from pathlib import Path

from sawmill_worker.vocabulary.version import VERSION

_PACKAGE = Path(__file__).parents[1]
_DIGITS = 16


@cache
def software() -> str:
    """The version, and the first digits of the SHA-256 of all modules of `sawmill_worker`, read once a process."""
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        code = path.read_bytes()
        digest.update(f"{path.relative_to(_PACKAGE)}\0{len(code)}\0".encode() + code)
    return f"{VERSION}+{digest.hexdigest()[:_DIGITS]}"
