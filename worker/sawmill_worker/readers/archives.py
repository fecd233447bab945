"""ZIP archives that are safe to unpack, decided from their directory alone."""

from pathlib import PurePosixPath
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

from sawmill_worker.files.errors import UnreadableScan, quoted
from sawmill_worker.readers.arrays import HARMLESS_BYTES, LARGEST_RATIO

MOST_MEMBERS = 100_000
ENCRYPTED = 0x1


def members(archive: ZipFile, max_bytes: int) -> list[ZipInfo]:
    """Every file in the archive, all of them checked.

    What is unpacked of a member never exceeds the size checked here: the reader of the standard library stops there.

    Raises
    ------
    UnreadableScan
        `unsafe-archive` or `too-large`.
    """
    infos = [info for info in archive.infolist() if not info.is_dir()]
    if len(infos) > MOST_MEMBERS:
        raise UnreadableScan("too-large", f"the archive holds {len(infos)} files; at most {MOST_MEMBERS} are allowed")
    for info in infos:
        _check_member(info)
    declared = sum(info.file_size for info in infos)
    stored = sum(info.compress_size for info in infos)
    if declared > max_bytes:
        raise UnreadableScan(
            "too-large",
            f"the archive unpacks to {declared} bytes and at most {max_bytes} are allowed or free; upload fewer rows",
        )
    if declared > HARMLESS_BYTES and stored * LARGEST_RATIO < declared:
        raise UnreadableScan(
            "too-large", f"the archive declares {declared} bytes and stores {stored}; no scan packs so well"
        )
    return infos


def _check_member(info: ZipInfo) -> None:
    name = repr(quoted(info.filename))
    path = PurePosixPath(info.filename.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts or ":" in info.filename:
        raise UnreadableScan(
            "unsafe-archive", f"the archive holds {name}, which points outside of it; pack plain names"
        )
    if info.flag_bits & ENCRYPTED:
        raise UnreadableScan("unsafe-archive", f"{name} is encrypted; pack the archive without a password")
    if info.compress_type not in {ZIP_STORED, ZIP_DEFLATED}:
        raise UnreadableScan("unsafe-archive", f"{name} is packed by method {info.compress_type}; use deflate or store")
