"""Results that are not as a job wrote them: other places of their values, other shapes, other files."""

import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from sawmill_formats.nexus import PACKED
from sawmill_platform.files.verified_results import compute_digest
from sawmill_store.store import Store


def written_by_its_job(store: Store, path: Path) -> None:
    """Give the row of a result the digest of the file as a test has changed it."""
    store.jobs.note_digest_of_result(path, compute_digest(path))


def endless(path: Path) -> None:
    """Write a file of two texts, at which the library's reader does not end."""
    with h5py.File(path, "w") as file:
        file["texts"] = np.array(["alpha", "beta"], h5py.string_dtype())
    make_endless(path)


def make_endless(path: Path) -> None:
    """Give the first text in a file's heap a size of -16 bytes, which its reader never gets beyond."""
    content = bytearray(path.read_bytes())
    size = content.index(b"GCOL") + 24
    content[size : size + 8] = b"\xf0" + 7 * b"\xff"
    path.write_bytes(content)


def in_place_of(change: Callable[[h5py.File, str, tuple[int, ...], Path], None]) -> Callable[[Path, str], None]:
    """Take the values away from a file, and put something else there."""

    def damage(path: Path, values: str) -> None:
        with h5py.File(path, "r+") as file:
            shape = file[values].shape
            del file[values]
            change(file, values, shape, path)

    return damage


def external(file: h5py.File, values: str, shape: tuple[int, ...], path: Path) -> None:
    database = path.parents[2] / "sawmill.db"
    file.create_dataset(values, shape, np.float32, external=[(str(database), 0, 4 * int(np.prod(shape)))])


def virtual(file: h5py.File, values: str, shape: tuple[int, ...], _: Path) -> None:
    layout = h5py.VirtualLayout(shape, np.float32)
    layout[...] = h5py.VirtualSource("/elsewhere.h5", "data", shape)
    file.create_virtual_dataset(values, layout)


def linked(file: h5py.File, values: str, _: tuple[int, ...], __: Path) -> None:
    file[values] = h5py.ExternalLink("/elsewhere.h5", "data")


def led_on(file: h5py.File, values: str, _: tuple[int, ...], __: Path) -> None:
    file[values] = h5py.SoftLink("/entry")


def huge(file: h5py.File, values: str, _: tuple[int, ...], __: Path) -> None:
    file.create_dataset(values, (2, 30_000, 30_000), np.float32, chunks=(1, 30_000, 30_000), **PACKED, fletcher32=True)


def never_written(file: h5py.File, values: str, shape: tuple[int, ...], _: Path) -> None:
    file.create_dataset(values, shape, np.float32, chunks=(1, *shape[1:]), **PACKED, fletcher32=True)


def as_a_link(path: Path, _: str) -> None:
    path.rename(path.with_name("elsewhere.h5"))
    path.symlink_to(path.with_name("elsewhere.h5"))


def another_file(path: Path, _: str) -> None:
    path.write_bytes(b"another one")


def cut_off(path: Path, _: str) -> None:
    os.truncate(path, path.stat().st_size // 2)


DAMAGES: dict[str, Callable[[Path, str], None]] = {
    each.__name__: in_place_of(each) for each in (external, virtual, linked, led_on, huge, never_written)
} | {each.__name__: each for each in (as_a_link, another_file, cut_off)}
