"""Checks of the machine: kernels, memory, the data folder with its disk and owners, limits of the system."""

import errno
import importlib
import os
import pkgutil
import shutil
from collections.abc import Iterable, Iterator
from contextlib import closing
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import NamedTuple

import sawmill_tomography as tomography
from sawmill_calibration.failures import memory_available
from sawmill_platform.attempts.limits import DATA_BYTES
from sawmill_platform.confinement import landlock
from sawmill_platform.errors import FolderUnavailable, StorageMisconfigured
from sawmill_platform.files.file_store import is_read_only, refuse_half_restored
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_service.http.listening import ListenError, files_needed, listen, possible_connections
from sawmill_service.pages.system.system_parts import Disk
from sawmill_service.settings import ServiceSettings
from sawmill_tomography.kernel_cache import holds_all


class State(StrEnum):
    """State of a subject."""

    GOOD = "good"
    WATCH = "watch"
    BAD = "bad"


class DoctorFinding(NamedTuple):
    """Result of one check: a sentence with the values seen, and the remedy, empty if nothing is to be done."""

    state: State
    subject: str
    sentence: str
    cure: str = ""


# Findings that need nothing, that should be mended, and with which the service does not work.
good, watch, bad = (partial(DoctorFinding, state) for state in State)

# File systems that do not suit SQLite: its write-ahead log needs memory shared by all processes, and reliable locks.
_OF_NETWORKS = {"nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "fuse.sshfs", "ceph", "fuse.glusterfs", "lustre", "afs"}
_MOUNTS = Path("/proc/self/mountinfo")
_OTHERS_MAY_WRITE, _ANYBODY_MAY_READ = 0o022, 0o007
_OF_THE_DISK = "lost+found"  # belongs to root if the folder is the root of a disk


def watched_folders(folders: Iterable[Path]) -> Iterator[DoctorFinding]:
    """Check that this user can take files from the folders that may be watched."""
    for folder in folders:
        if folder.is_dir() and os.access(folder, os.R_OK | os.W_OK | os.X_OK):
            yield good("watched folders", f"{folder} can be read and written")
        else:
            sentence = f"{folder} of SAWMILL_WATCH_FOLDERS is missing, or this user cannot read and write it"
            yield bad("watched folders", sentence, "mount it, or change its owner")


def limits_of_system(settings: ServiceSettings, execution: ExecutionSettings) -> Iterator[DoctorFinding]:
    """Check that the system's limits allow the settings."""
    most, possible = settings.max_connections, possible_connections(settings.max_connections)
    if possible == most:
        yield good("open files", f"enough for {most} connections")
    else:
        yield watch(
            "open files",
            f"{most} connections need {files_needed(most)} open files; the system allows {possible} connections",
            f"raise its limit (ulimit -n), or set SAWMILL_MAX_CONNECTIONS to {possible}",
        )
    if os.geteuid() == 0:
        yield watch(
            "user",
            "this is root: a service of root that somebody takes over has all rights on the machine",
            "run the service, and the doctor, as a user of its own: see docs/do/install.md",
        )
    else:
        yield good("user", f"user {os.geteuid()}, who is not root")
    if not execution.confine_attempts:
        yield watch(
            "confinement",
            "SAWMILL_CONFINE_ATTEMPTS is off: a hostile upload could reach all files of this user",
            "unset it",
        )
    elif landlock.version() == 0:
        yield watch(
            "confinement",
            "the kernel has no Landlock: a hostile upload could reach all files of this user",
            "use Linux 5.13 or later with Landlock enabled (lsm=landlock,...)",
        )
    else:
        yield good("confinement", f"Landlock {landlock.version()} keeps jobs to their own files")


def memory() -> DoctorFinding:
    """Check that the memory suffices for a job."""
    available = memory_available()
    sentence = f"{available / 1e9:.1f} GB of memory are free, and a job may take {DATA_BYTES / 1e9:.1f} GB"
    if available < DATA_BYTES:
        return watch("memory", sentence, "end other programs, or set SAWMILL_WORKERS=1")
    return good("memory", sentence)


def kernels() -> DoctorFinding:
    """Check that the cache has the compiled kernels of this installation."""
    names = [found.name for found in pkgutil.walk_packages(tomography.__path__, f"{tomography.__name__}.")]
    try:
        modules = [importlib.import_module(name) for name in names if name.endswith("_numba")]
    except RuntimeError as error:  # from Numba, if neither the installation nor the user's cache can be written to
        sentence = f"{error}: jobs keep theirs in the data folder, and the first ones wait for them, up to a minute"
        return watch("kernels", sentence, "run sawmill compile as the installation's owner")
    missing = [module.__name__.rpartition(".")[2] for module in modules if not holds_all(module)]
    if missing:
        sentence = f"not compiled yet: {', '.join(missing)}; the first jobs wait for it, up to a minute"
        return watch("kernels", sentence, "run sawmill compile as the service's user")
    return good("kernels", f"{len(modules)} files of compiled kernels are in the cache")


def address(settings: ServiceSettings, *, may_be_ours: bool) -> DoctorFinding:
    """Check that the service could listen; `may_be_ours` if it is unknown whether a present listener is the service."""
    try:
        with closing(listen(settings.host, settings.port, guarded=True)) as listening:
            port = listening.getsockname()[1]
    except ListenError as error:
        if may_be_ours and isinstance(error.__cause__, OSError) and error.__cause__.errno == errno.EADDRINUSE:
            sentence = f"something listens on {settings.host} with port {settings.port}: the service, if it runs"
            return good("address", sentence)
        return bad("address", str(error), "mend SAWMILL_HOST and SAWMILL_PORT")
    return good("address", f"{settings.host} with port {port} can be listened on")


def data_folder(storage: StorageSettings) -> Iterator[DoctorFinding]:
    """Check that the folder exists, on a suitable disk with free space, and belongs to this user; nothing is made."""
    folder = storage.data_folder
    if not folder.is_dir():
        if storage.is_one_file:  # a database server knows whether a folder should exist
            yield watch("data folder", f"{folder} is not there", "the first start of sawmill serve makes it")
        return
    yield _writable(folder)
    if not is_closed(folder):
        try:
            refuse_half_restored(folder)
        except StorageMisconfigured as error:
            yield bad("data folder", str(error), "wait for its end, or give sawmill restore BACKUP once more")
    if storage.is_one_file and (kind := file_system(folder)) in _OF_NETWORKS:
        yield bad(
            "data folder",
            f"{folder} is on a network file system ({kind}), where SQLite loses rows",
            "move it to a local disk, or give SAWMILL_DATABASE_URL=postgresql://...",
        )
    yield from _room(folder, storage.disk_reserve_bytes)


def is_closed(folder: Path) -> bool:
    """Return whether the folder exists and this user cannot work in it."""
    try:
        return folder.is_dir() and (is_read_only(folder) or not os.access(folder, os.R_OK | os.W_OK | os.X_OK))
    except FolderUnavailable:
        return True


def _writable(folder: Path) -> DoctorFinding:
    cure = "look for the disk's errors in the system's log (dmesg), mend it (fsck), and mount it for writing again"
    try:
        if is_read_only(folder):
            return bad("data folder", f"{folder} is on a disk that is read-only", cure)
    except FolderUnavailable as error:
        return bad("data folder", str(error), cure)
    if is_closed(folder):
        return bad(
            "data folder",
            f"{folder} belongs to user {_owner(folder)} and cannot be written to by this one",
            run_as_owner(folder),
        )
    # Files left by a command of another user, above all root, to which the service cannot write.
    stray = next((one for one in _two_levels(folder) if one.lstat().st_uid != folder.stat().st_uid), None)
    if stray is not None:
        return bad(
            "data folder",
            f"{stray} belongs to user {_owner(stray)}, and the folder to {_owner(folder)}",
            f"chown -R {_owner(folder)} {folder}; give commands as {_owner(folder)}",
        )
    mode = folder.stat().st_mode & 0o777
    if mode & (_OTHERS_MAY_WRITE | _ANYBODY_MAY_READ):
        state, do, taken = (
            (State.BAD, "write to", "go-w") if mode & _OTHERS_MAY_WRITE else (State.WATCH, "read", "o-rwx")
        )
        sentence = f"others on this machine may {do} {folder} ({mode:o})"
        return DoctorFinding(state, "data folder", sentence, f"chmod {taken} {folder}")
    return good("data folder", f"{folder}, of user {_owner(folder)}")


def _room(folder: Path, reserve_bytes: int) -> Iterator[DoctorFinding]:
    usage = shutil.disk_usage(folder)
    state = State(Disk(usage.free, usage.total, reserve_bytes, scans_bytes=0).tone)
    sentence = f"{usage.free / 1e9:.1f} GB of {usage.total / 1e9:.0f} GB are free; below {reserve_bytes / 1e9:.1f} GB "
    sentence += "it counts as full"
    cure = "delete scans and reconstructions that nobody needs, or move the data folder to a larger disk"
    yield DoctorFinding(state, "disk", sentence, "" if state is State.GOOD else cure)
    names = os.statvfs(folder)
    if names.f_files and names.f_favail < names.f_files // 100:
        sentence = f"{names.f_favail} names of {names.f_files} are left on the disk (inodes)"
        yield watch("disk", sentence, "remove small files: df -i shows the disk")


def file_system(folder: Path, mounts: Path = _MOUNTS) -> str:
    """Return the type of the file system of a folder, as in /proc/self/mountinfo (proc(5))."""
    resolved = folder.resolve()
    mount_point, kind = Path("/"), "?"
    for line in mounts.read_text().splitlines():
        mount, _, source = line.partition(" - ")
        point = Path(mount.split()[4].replace(r"\040", " "))
        # The last mount at a point hides earlier mounts at the same point.
        if resolved.is_relative_to(point) and point.is_relative_to(mount_point):
            mount_point, kind = point, source.split()[0]
    return kind


def run_as_owner(folder: Path) -> str:
    """Return the cure for a folder of another user."""
    return f"run as user {_owner(folder)}, or change the owner: chown -R USER {folder}"


def _two_levels(folder: Path) -> Iterator[Path]:
    for entry in folder.iterdir():
        if entry.name == _OF_THE_DISK:
            continue
        yield entry
        if entry.is_dir() and not entry.is_symlink():
            yield from entry.iterdir()


def _owner(path: Path) -> str:
    """Return the owner by name, or by number without a name, as in containers; chown(1) accepts both."""
    try:
        return path.owner()
    except KeyError:
        return str(path.stat().st_uid)
