"""The sha256 of what is sent: entity tags and digests are made of it, and it is computed once."""

import hashlib
import os
import threading
from base64 import b64encode
from collections import OrderedDict
from collections.abc import Hashable
from pathlib import Path

import structlog

# Of pictures that are kept as they were sent; one alone may have a quarter.
_KEPT_BYTES = 16 * 1024**2
# A digest and its key have some 300 bytes.
_MOST_DIGESTS = 10_000
# Larger files have their digest beside them: it outlives the process.
_NOTED_FROM_BYTES = 8 * 1024**2

log = structlog.get_logger(__name__)


def tag_of(digest: bytes) -> str:
    """A strong entity tag."""
    return f'"{digest.hex()}"'


def repr_digest(digest: bytes) -> str:
    """As in the header `Repr-Digest` (RFC 9530)."""
    return f"sha-256=:{b64encode(digest).decode()}:"


def key_of(path: str, made_of: Hashable) -> Hashable:
    """Of a content that is made for a path from other values, which may be long."""
    return path, hashlib.sha256(repr(made_of).encode()).digest()


class Digests:
    """Digests by what was sent, the newest, and small contents with theirs."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._hashing: dict[Hashable, threading.Lock] = {}
        self._digests: OrderedDict[Hashable, bytes] = OrderedDict()
        self._contents: OrderedDict[Hashable, bytes] = OrderedDict()
        self._kept_bytes = 0

    def known(self, key: Hashable) -> bytes | None:
        """The digest that was noted under a key."""
        with self._lock:
            return self._digests.get(key)

    def content(self, key: Hashable) -> bytes | None:
        """The content that was noted under a key, if it is kept still."""
        with self._lock:
            if key in self._contents:
                self._contents.move_to_end(key)
            return self._contents.get(key)

    def note(self, key: Hashable, content: bytes, *, keep: bool = True) -> bytes:
        """The digest of a content, which is known by its key from now on; a small content is kept with it."""
        digest = hashlib.sha256(content).digest()
        with self._lock:
            self._note(key, digest)
            if keep and key not in self._contents and len(content) <= _KEPT_BYTES // 4:
                self._contents[key] = content
                self._kept_bytes += len(content)
            while self._kept_bytes > _KEPT_BYTES:
                self._kept_bytes -= len(self._contents.popitem(last=False)[1])
        return digest

    def of_file(self, path: Path, status: os.stat_result) -> bytes:
        """The digest of a file as it was when `status` was taken; the first time takes as long as reading it."""
        key = (str(path), status.st_size, status.st_mtime_ns)
        if (digest := self.known(key)) is None:
            if status.st_size >= _NOTED_FROM_BYTES:
                return self._of_large_file(key, path, status)
            digest = _computed(path)
            with self._lock:
                self._note(key, digest)
        return digest

    def _of_large_file(self, key: Hashable, path: Path, status: os.stat_result) -> bytes:
        """Many that ask for one at once wait for one of them; those who ask for another file do not."""
        with self._lock:
            hashing = self._hashing.setdefault(key, threading.Lock())
        try:
            with hashing:
                digest = self.known(key) or _noted_or_computed(path, status)
                with self._lock:
                    self._note(key, digest)
                return digest
        finally:
            with self._lock:
                self._hashing.pop(key, None)

    def _note(self, key: Hashable, digest: bytes) -> None:
        self._digests[key] = digest
        if len(self._digests) > _MOST_DIGESTS:
            self._digests.popitem(last=False)


def _noted_or_computed(path: Path, status: os.stat_result) -> bytes:
    note, stands_for = path.with_name(f".{path.name}.sha256"), f"{status.st_size} {status.st_mtime_ns}"
    try:
        digest, _, noted_for = note.read_text().partition(" ")
        if noted_for == stands_for:
            return bytes.fromhex(digest)
    except FileNotFoundError:
        pass
    computed = _computed(path)
    try:
        new = note.with_name(f"{note.name}.{threading.get_ident()}")
        new.write_text(f"{computed.hex()} {stands_for}")
        new.replace(note)
    except OSError as error:  # a full disk: the file can be sent all the same
        log.warning("digest-not-kept", file=path.name, reason=str(error))
    return computed


def _computed(path: Path) -> bytes:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()
