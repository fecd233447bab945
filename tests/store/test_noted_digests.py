"""Digests beside large files stand for one content each."""

import errno
import hashlib
import os

import pytest
from system_calls import at_call, refusing

from sawmill_platform.errors import StorageFull, StorageUnavailable
from sawmill_platform.files.digests import NOTED_FROM_BYTES, compute_digest, note_digests, read_note

LARGE = bytes(NOTED_FROM_BYTES)


@pytest.fixture
def volume(tmp_path):
    path = tmp_path / "volume.h5"
    path.write_bytes(LARGE)
    return path


def test_large_files_that_are_downloaded_have_their_digests_beside_them(tmp_path, volume):
    for name, content in (("result.h5", LARGE[1:]), ("more.h5", LARGE)):
        (tmp_path / name).write_bytes(content)
    (tmp_path / "more").mkdir()
    note_digests(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        *("volume.h5", "result.h5", "more.h5", "more"),
        ".volume.h5.sha256",
        ".more.h5.sha256",
    }
    note = read_note(volume)
    assert (note.digest, note.is_of(volume.stat())) == (hashlib.sha256(LARGE).digest(), True)


def test_a_note_stands_for_no_other_content(tmp_path, volume):
    """As of a file that was put back from a backup, and of a note that was garbled."""
    status = volume.stat()
    note_digests(tmp_path)
    os.utime(volume, ns=(status.st_atime_ns, status.st_mtime_ns + 1))
    assert not read_note(volume).is_of(volume.stat())
    os.utime(volume, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert read_note(volume).is_of(volume.stat())
    note = tmp_path / ".volume.h5.sha256"
    written = note.read_bytes()
    for garbled in (b"", b"\xff", written[2:], b"0x" + written[2:], b"00" + written, written + b"\n"):
        note.write_bytes(garbled)
        assert read_note(volume) is None, garbled


def test_a_file_that_is_replaced_while_it_is_read_has_no_digest(volume):
    status = volume.stat()
    volume.write_bytes(b"another one")
    with pytest.raises(StorageUnavailable, match=r"volume\.h5 was replaced while it was read"):
        compute_digest(volume, status)


@pytest.mark.usefixtures("volume")
def test_a_full_disk_is_one_and_nothing_half_written_stays(tmp_path):
    with (
        at_call("os.rename", refusing(errno.ENOSPC), below=tmp_path),
        pytest.raises(StorageFull, match="a result was given up"),
    ):
        note_digests(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["volume.h5"]
