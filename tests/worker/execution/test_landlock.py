"""Kernels that know less of Landlock, or nothing."""

import subprocess
import sys

import pytest
from structlog.testing import capture_logs

from sawmill_platform.confinement import landlock
from sawmill_platform.confinement.confinement import Surroundings, say_if_unconfined
from sawmill_platform.workers.settings import ExecutionSettings

WITHOUT_LANDLOCK = """
import ctypes, errno, struct, sys
from pathlib import Path

# Linux's own answer to a call that it lacks, by a filter of system calls (<linux/seccomp.h>) for those of Landlock.
LOAD, AT_LEAST, ABOVE, RETURN = 0x20, 0x35, 0x25, 0x06
lines = [(LOAD, 0, 0, 0), (AT_LEAST, 0, 2, 444), (ABOVE, 1, 0, 446), (RETURN, 0, 0, 0x50000 | errno.ENOSYS)]
lines.append((RETURN, 0, 0, 0x7FFF0000))
program = b"".join(struct.pack("=HBBI", *line) for line in lines)

class Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_char_p))

libc = ctypes.CDLL(None)
assert libc.prctl(38, 1, 0, 0, 0) == 0
if libc.prctl(22, 2, ctypes.byref(Program(len(lines), program))):
    raise SystemExit("this kernel has no seccomp")

from sawmill_platform.confinement import landlock
from sawmill_platform.confinement.confinement import confine_to
from sawmill_platform.contracts.attempts import AttemptInput

assert landlock.version() == 0
folder = Path(sys.argv[1])
confine_to(AttemptInput(kept=folder), folder)
(folder / "result").touch()
"""


def test_rights_that_a_kernel_does_not_know_are_not_asked_for():
    # <linux/landlock.h>: REFER came with version 2, TRUNCATE with 3, TCP with 4, IOCTL_DEV with 5, the scopes with 6.
    known = [landlock.handled_by(version) for version in range(1, 8)]
    assert [each.file_rights.bit_length() for each in known] == [13, 14, 15, 15, 16, 16, 16]
    assert [each.tcp_rights for each in known] == [0, 0, 0, 3, 3, 3, 3]
    assert [each.scopes for each in known] == [0, 0, 0, 0, 0, 3, 3]


@pytest.mark.parametrize(
    ("version", "wanted", "user", "lines"),
    [
        (0, True, 1000, ["attempts-not-confined"]),
        (3, True, 1000, ["attempts-confined-in-part"]),
        (6, True, 1000, []),
        (6, True, 0, ["run-as-root"]),
        (7, False, 1000, ["attempts-not-confined"]),
    ],
)
def test_what_the_kernel_lacks_and_root_are_said_once_at_the_start(version, wanted, user, lines):
    with capture_logs() as log:
        say_if_unconfined(ExecutionSettings(confine_attempts=wanted), Surroundings(user, version))
    assert [line["event"] for line in log] == lines


def test_a_kernel_without_landlock_lets_jobs_run(tmp_path):
    tmp_path.chmod(0o777)
    subprocess.run([sys.executable, "-c", WITHOUT_LANDLOCK, str(tmp_path)], check=True, timeout=60)
    assert (tmp_path / "result").exists()


CONFINED = """
import sys
from contextlib import suppress
from pathlib import Path
from sawmill_platform.confinement.landlock import confine

readable, held, writable = (Path(sys.argv[1]) / name for name in ("readable", "held", "writable"))
confine([readable], [writable], held=[held])
for folder in (readable, held):
    assert (folder / "file").read_text() == "as it was"
    for change in (lambda file: file.write_text("changed"), Path.unlink, lambda file: file.with_name("more").touch()):
        with suppress(PermissionError):
            change(folder / "file")
(writable / "file").write_text("changed")
"""


@pytest.mark.skipif(landlock.version() == 0, reason="the kernel has no Landlock")
def test_what_may_be_read_may_not_be_changed(tmp_path):
    for name in ("readable", "held", "writable"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text("as it was")
    subprocess.run([sys.executable, "-c", CONFINED, str(tmp_path)], check=True, timeout=60)
    texts = {str(path.relative_to(tmp_path)): path.read_text() for path in tmp_path.rglob("*") if path.is_file()}
    assert texts == {"readable/file": "as it was", "held/file": "as it was", "writable/file": "changed"}
