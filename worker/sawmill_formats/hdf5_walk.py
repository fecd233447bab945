"""Walk through an HDF5 file as readers do: `python -m sawmill_platform.attempts.importing sawmill_formats.hdf5_walk`.

The process may crash or loop, which is its purpose (`reading_apart`). What the library reports as an error is no matter
of the walk: the reader that opens the file afterwards meets the same error, and reports it.
"""

import resource
import sys
from contextlib import suppress
from pathlib import Path

import h5py

from sawmill_formats.hdf5 import open_hdf5
from sawmill_platform.confinement import landlock
from sawmill_platform.confinement.seccomp import refuse_calls

MEMORY_BYTES = 2**31
# Datasets of at most this size are read: of a text, reading uses more structures of the file than its header.
READ_BYTES = 2**20
MOST_OBJECTS = 10_000


def main() -> None:
    """Walk through the file that the command names."""
    path, *follow_links = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if not follow_links and landlock.version() > 0:
        landlock.confine([Path(path)], [])
    refuse_calls()
    walk(Path(path), follow_links=bool(follow_links))


def walk(path: Path, *, follow_links: bool) -> None:
    """Read the structure of a file, its attributes and its small datasets."""
    with suppress(Exception), open_hdf5(path) as file:
        _walk(file, follow_links=follow_links)


def _walk(file: h5py.File, *, follow_links: bool) -> None:
    objects, seen = [file["/"]], set[tuple[tuple[int, ...], tuple[int, ...]]]()
    while objects and len(seen) < MOST_OBJECTS:
        node = objects.pop()
        with suppress(Exception):
            about = h5py.h5g.get_objinfo(node.id)
            address = (tuple(about.fileno), tuple(about.objno))
            if address in seen:
                continue
            seen.add(address)
            _read(node, follow_links=follow_links)
        if isinstance(node, h5py.Group):
            with suppress(Exception):
                for name in node:
                    key = name if isinstance(name, bytes) else name.encode("utf-8", "surrogateescape")
                    with suppress(Exception):
                        if follow_links or node.id.links.get_info(key).type != h5py.h5l.TYPE_EXTERNAL:
                            objects.append(node[key])


def _read(node: h5py.Group | h5py.Dataset, *, follow_links: bool) -> None:
    """Read attributes, where the chunks of a dataset lie, and a small dataset as a whole."""
    for name in node.attrs:
        with suppress(Exception):
            node.attrs[name]
    if not isinstance(node, h5py.Dataset):
        return
    node.id.get_storage_size()
    if node.chunks is not None:
        node.id.chunk_iter(lambda _: None)
    if (node.is_virtual or node.external) and not follow_links:
        return
    if node.nbytes <= READ_BYTES:
        node[()]
