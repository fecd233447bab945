"""Watched folders against a store: each file becomes one scan, whatever happens, and each trouble is said once."""

import errno
import hashlib
import multiprocessing
import os
import re
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random

import pytest
from results import succeed
from structlog.testing import capture_logs

from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerRequest, ScannerSpec
from sawmill_contracts.scans import Scan
from sawmill_contracts.watched_folders import WatchedFolder
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_platform.errors import Invalid
from sawmill_platform.settings import StorageSettings
from sawmill_store.scans.scans import Scans
from sawmill_store.store import Store
from sawmill_worker.watched_folders import WAIT_S, WatchedFolders

BAD = b"no scan"
FILES = 20


@dataclass
class Watched:
    """A scanner's folder, its taker with a clock, and a worker that refuses what begins with `BAD`."""

    store: Store
    folder: Path
    now_s: float = 1000.0

    def __post_init__(self) -> None:
        self.scanner_id, self.taker = self.store.scanners.create(spec(self.folder)).id, self.new_taker()

    def new_taker(self) -> WatchedFolders:
        return WatchedFolders(self.store, threading.Event(), lambda: self.now_s)

    def put(self, name: str, content: bytes) -> Path:
        path = self.folder / name
        path.write_bytes(content)
        return path

    def look(self, times: int = 1, *, after_s: float = 0.0) -> None:
        for _ in range(times):
            self.now_s += after_s
            self.taker.look()
            self.taker.wait(60.0)

    def take(self) -> None:
        self.look()
        self.look(after_s=10.0)

    def settle(self) -> None:
        self.take()
        self.read()
        self.look()

    def read(self) -> None:
        while claim := self.store.jobs.claim("a worker"):
            if self.content(self.store.scans.get(claim.job.subject_id)).startswith(BAD):
                failure = Failure(kind=FailureKind.INPUT, code="unknown-format", detail="the file is no scan")
                self.store.jobs.fail(claim, failure)
                continue
            succeed(self.store, claim)

    def again(self) -> None:
        self.taker.close()
        self.taker = self.new_taker()

    def change(self, **changes: object) -> None:
        scanner = self.store.scanners.get(self.scanner_id)
        watched = scanner.watched_folder.model_copy(update=changes)
        self.store.scanners.update(self.scanner_id, scanner.model_copy(update={"watched_folder": watched}))

    def scans(self) -> list[Scan]:
        return self.store.scans.page(scanner_id=self.scanner_id, limit=100).items[::-1]

    def contents(self) -> dict[str, bytes]:
        return {scan.name: self.content(scan) for scan in self.scans()}

    def content(self, scan: Scan) -> bytes:
        return (self.store.files.folder / "uploads/scans" / scan.id / "original").read_bytes()

    def refused(self) -> dict[str, bytes]:
        files = (path for path in self.folder.glob("refused/*/*") if not path.name.endswith(".reason.txt"))
        return {path.name: path.read_bytes() for path in files}

    def reason(self, name: str) -> list[str]:
        (path,) = self.folder.glob(f"refused/*/{name}.reason.txt")
        return path.read_text().splitlines()

    def taken(self) -> list[Path]:
        return list(self.folder.glob("taken/*/*"))

    def left(self) -> list[str]:
        return sorted(path.name for path in self.folder.iterdir() if path.name not in {"taken", "refused"})


def spec(folder: Path, **fields: object) -> ScannerSpec:
    constants = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=8, detector_pitch_mm=1.5)
    rule = {"data": "line-integrals", "angles_deg": "0:120", "match": "*.npy"}
    phantoms = {**rule, "match": "phantom*.npy", "phantom_id": "l-shape"}
    watched = WatchedFolder(**{**rule, "priority": "batch", "folder": str(folder), "exceptions": [phantoms], **fields})
    return ScannerSpec(name="Line 2", constants=constants, watched_folder=watched)


@pytest.fixture
def place() -> Iterator[Path]:
    """A folder in memory, where there is such a file system: hundreds of commits take no time."""
    memory = "/dev/shm"  # noqa: S108 - a folder of its own in it
    with tempfile.TemporaryDirectory(dir=memory if os.access(memory, os.W_OK) else None) as folder:
        yield Path(folder)


def begin(place: Path, empty_data: Path, root: Path) -> Watched:
    shutil.copytree(empty_data, place / "data")
    store = Store(StorageSettings(data_folder=place / "data", database_url=None, watch_folders=[root]))
    folder = root / "line-2"
    folder.mkdir(parents=True)
    return Watched(store, folder)


@pytest.fixture
def watched(place: Path, empty_data: Path) -> Iterator[Watched]:
    made = begin(place, empty_data, place / "scanners")
    yield made
    made.taker.close()
    made.store.close()


@pytest.fixture
def log() -> Iterator[Callable[[str], list[dict]]]:
    with capture_logs() as entries:

        def lines(event: str) -> list[dict]:
            found = [entry for entry in entries if entry["event"] == event]
            entries[:] = [entry for entry in entries if entry["event"] != event]
            return found

        yield lines


def test_a_file_becomes_a_scan_as_the_scanner_says_and_is_removed(watched):
    watched.put("phantom 1.npy", b"p" * 100)
    watched.put("log.npy", b"l" * 100)
    watched.settle()
    phantom, wood = sorted(watched.scans(), key=lambda scan: scan.name, reverse=True)
    assert (phantom.name, phantom.phantom_id, wood.phantom_id) == ("phantom 1.npy", "l-shape", None)
    assert (phantom.angles_deg, phantom.sha256) == ("0:120", hashlib.sha256(b"p" * 100).hexdigest())
    job = watched.store.jobs.get(wood.job_id)
    assert (job.priority, job.asked_by) == ("batch", f"watched folder of {watched.scanner_id}")
    assert (watched.left(), watched.taken(), watched.refused()) == ([], [], {})


def test_a_file_is_whole_once_two_looks_far_enough_apart_see_the_same(watched):
    watched.put("log.npy", b"log")
    watched.look()
    watched.look(after_s=9.0)
    assert watched.scans() == []
    watched.look(after_s=1.0)
    assert watched.contents() == {"log.npy": b"log"}


@pytest.mark.parametrize("change", ["longer", "shorter", "same length", "time put back", "another file"])
def test_any_change_begins_anew(watched, change):
    path = watched.put("log.npy", b"12345")
    os.utime(path, ns=(0, 10**18))
    watched.look()
    if change == "another file":
        path.unlink()
    content = {"longer": b"123456", "shorter": b"1234", "another file": b"54321", "same length": b"12354"}
    path.write_bytes(content.get(change, b"12345"))
    if change == "time put back":  # a clock that steps back, as the writer's or the share's
        os.utime(path, ns=(0, 10**17))
    watched.look(2, after_s=9.0)
    assert watched.scans() == []
    watched.look(after_s=1.0)
    assert len(watched.scans()) == 1


def test_an_empty_file_was_just_made_unless_it_is_marked(watched):
    watched.put("empty.npy", b"")
    watched.look(3, after_s=100.0)
    assert watched.left() == ["empty.npy"]
    watched.put("empty.npy.done", b"")
    watched.look()
    assert (watched.reason("empty.npy")[1], watched.left()) == ("code: empty-file", [])


def test_a_mark_says_that_a_file_is_whole_and_a_late_one_says_nothing_of_the_next_file(watched):
    watched.change(still_for_s=None)
    watched.put("scan.npy", b"first")
    watched.look(3, after_s=1000.0)
    assert watched.scans() == []
    watched.put("scan.npy.done", b"")
    watched.look()
    assert watched.left() == []
    late = watched.put("scan.npy.done", b"")
    half = watched.put("scan.npy", b"sec")
    os.utime(late, ns=(0, half.stat().st_mtime_ns - 1))
    watched.look(3, after_s=1000.0)
    assert watched.left() == ["scan.npy", "scan.npy.done"]
    half.write_bytes(b"second")
    late.touch()
    watched.look()
    assert [watched.content(scan) for scan in watched.scans()] == [b"first", b"second"]


def test_a_mark_without_a_file_goes_after_a_while(watched):
    watched.put("gone.npy.done", b"")
    watched.put(".done", b"")
    watched.put("notes.done", b"")
    watched.look(2, after_s=WAIT_S - 1.0)
    assert "gone.npy.done" in watched.left()
    watched.look(after_s=1.0)
    assert watched.left() == [".done", "notes.done"]


def test_equal_contents_and_a_name_used_again_are_scans_of_their_own(watched):
    for names in ("ab", "a", "a"):
        for name in names:
            watched.put(f"{name}.npy", b"same")
        watched.settle()
    assert sorted(scan.name for scan in watched.scans()) == ["a.npy", "a.npy", "a.npy", "b.npy"]


def test_what_the_service_refuses_is_in_refused_with_the_reason(watched, log, monkeypatch):
    monkeypatch.setenv("SAWMILL_MAX_UPLOAD_BYTES", "1000")
    for name, content in {"bad.npy": BAD, "big.npy": b"x" * 1001, "good.npy": b"g"}.items():
        watched.put(name, content)
    watched.settle()
    assert watched.refused() == {"bad.npy": BAD, "big.npy": b"x" * 1001}
    (bad,) = (each for each in watched.scans() if each.name == "bad.npy")
    assert watched.reason("bad.npy") == ["the file is no scan", "code: unknown-format", f"scan: {bad.id}"]
    assert watched.reason("big.npy")[1] == "code: upload-too-large"
    assert {line["name"] for line in log("watched-refused")} == {"bad.npy", "big.npy"}
    watched.put("bad.npy", BAD + b" again")
    watched.settle()
    assert sorted(watched.refused().values()) == [BAD, BAD + b" again", b"x" * 1001]
    assert (watched.left(), watched.taken()) == ([], [])


def test_refused_files_can_be_read_by_those_who_can_read_the_folder(watched):
    watched.folder.chmod(0o755)
    watched.put("bad.npy", BAD)
    mask = os.umask(0o077)  # as the units have it
    try:
        watched.settle()
    finally:
        os.umask(mask)
    (reason,) = watched.folder.glob("refused/*/*.reason.txt")
    assert (reason.stat().st_mode & 0o777, reason.parent.stat().st_mode & 0o777) == (0o644, 0o755)


@pytest.mark.parametrize("killed", ["before the move", "before the row", "after the row", "before the reason"])
def test_a_file_whose_taker_was_killed_makes_one_scan(watched, killed):
    name, content = ("bad.npy", BAD) if killed == "before the reason" else ("log.npy", b"log")
    watched.put(name, content)
    watched.take()
    (file,) = watched.taken()
    (scan,) = watched.scans()
    if killed == "before the move":
        (watched.folder / "taken" / ("0" * 32)).mkdir()
    if killed == "before the row":
        before = watched.folder / "taken" / ("1" * 32)
        before.mkdir()
        (before / "next.npy").write_bytes(b"next")
    if killed == "after the row":
        file.parent.rename(watched.folder / "taken" / scan.id)
    watched.read()
    watched.again()
    watched.look(3)
    watched.read()
    watched.look()
    expected = {"next.npy": b"next", name: content} if killed == "before the row" else {name: content}
    assert watched.contents() == expected
    assert list((watched.folder / "taken").iterdir()) == []


def test_a_scan_that_was_deleted_at_once_is_not_made_again(watched):
    watched.put("log.npy", b"log")
    watched.take()
    watched.read()
    watched.store.scans.delete(watched.scans()[0].id)
    watched.look()
    assert (watched.scans(), watched.reason("log.npy")[1]) == ([], "code: scan-not-found")


@pytest.mark.parametrize("when", ["before its copy", "after its copy"])
def test_a_file_that_is_written_to_after_it_was_taken(watched, when):
    path = watched.put("log.npy", b"first ")
    with path.open("ab") as writer:
        if when == "before its copy":
            taken = watched.folder / "taken" / ("1" * 32)
            taken.mkdir(parents=True)
            path.rename(taken / path.name)
            watched.look()
        else:
            watched.take()
        writer.write(b"and last")
        writer.flush()
        watched.look()
    watched.look()
    watched.read()
    watched.look()
    if when == "before its copy":
        assert (watched.contents(), watched.refused()) == ({"log.npy": b"first and last"}, {})
    else:
        assert (watched.contents(), watched.refused()) == ({"log.npy": b"first "}, {"log.npy": b"first and last"})
        assert f"scan {watched.scans()[0].id} has what it was then" in watched.reason("log.npy")[0]


def test_a_touched_file_of_equal_bytes_has_not_changed(watched):
    watched.put("log.npy", b"log")
    watched.take()
    os.utime(watched.taken()[0], (1, 1))
    watched.read()
    watched.look()
    assert (watched.taken(), watched.refused()) == ([], {})


def test_a_folder_on_another_file_system_gives_whole_files(place, empty_data, tmp_path, monkeypatch):
    if tmp_path.stat().st_dev == place.stat().st_dev:
        pytest.skip("there is one file system here")

    def not_owner(*_, **__):
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "fchmod", not_owner)  # as on a share whose files belong to another user
    watched = begin(place, empty_data, tmp_path / "scanners")
    content = bytes(range(256)) * 300
    watched.put("log.npy", content)
    watched.put("bad.npy", BAD)
    watched.settle()
    assert watched.contents() == {"log.npy": content, "bad.npy": BAD}
    assert (watched.left(), watched.taken(), watched.refused()) == ([], [], {"bad.npy": BAD})
    watched.taker.close()
    watched.store.close()


def test_links_folders_and_names_that_nothing_matches_are_left_alone_and_named_once(watched, log, tmp_path):
    (tmp_path / "secret.npy").write_bytes(b"secret")
    (watched.folder / "link.npy").symlink_to(tmp_path / "secret.npy")
    (watched.folder / "folder.npy").mkdir()
    os.mkfifo(watched.folder / "pipe.npy")
    for name in ("notes.txt", ".hidden.npy", "a.npy.tmp", "b.npy.part", "c.npy~", "x" * 201 + ".npy"):
        watched.put(name, b"x")
    watched.look(5, after_s=100.0)
    alone = sorted(line["about"] for line in log("watched-left-alone"))
    assert alone == ["folder.npy", "link.npy", "notes.txt", "pipe.npy", "x" * 201 + ".npy"]
    assert watched.scans() == []


@pytest.mark.parametrize(
    "name", ["new\nline.npy", "\x1b[31mred.npy", "\u202egpj.npy", "-rf.npy", os.fsdecode(b"\xff.npy")]
)
def test_a_hostile_name_is_a_scan_or_a_refusal_of_one_line(watched, name):
    watched.put(name, b"log")
    watched.put(f"phantom{name}", BAD)
    watched.settle()
    assert len(watched.scans()) == 2
    assert all(scan.name.isprintable() for scan in watched.scans())
    assert (watched.left(), watched.refused()) == ([], {f"phantom{name}": BAD})


@pytest.mark.parametrize("link", ["the folder", "taken", "refused", "a taking", "a file in a taking", "the reason"])
def test_a_link_in_place_of_a_folder_or_a_file_leads_nowhere(watched, tmp_path, log, link):
    (tmp_path / "secret.npy").write_bytes(b"secret")
    watched.put("bad.npy", BAD)
    taken = watched.folder / "taken" / ("0" * 32)
    if link == "the folder":
        watched.folder.rename(tmp_path / "moved")
        watched.folder.symlink_to(tmp_path)
    elif link in {"taken", "refused"}:
        (watched.folder / link).symlink_to(tmp_path)
    elif link == "a taking":
        taken.parent.mkdir()
        taken.symlink_to(tmp_path)
    elif link == "a file in a taking":
        taken.mkdir(parents=True)
        (taken / "secret.npy").symlink_to(tmp_path / "secret.npy")
    else:
        today = watched.folder / "refused" / time.strftime("%Y-%m-%d", time.gmtime())
        today.mkdir(parents=True)
        (today / "bad.npy.reason.txt").symlink_to(tmp_path / "secret.npy")
    watched.settle()
    watched.settle()
    assert (tmp_path / "secret.npy").read_bytes() == b"secret"
    assert {path.name for path in tmp_path.iterdir()} <= {"secret.npy", "moved"}
    assert b"secret" not in watched.contents().values()
    assert bool(log("watched-waits")) is (link != "the reason")


@pytest.mark.parametrize("name", ["../elsewhere", "0" * 31, f"{'0' * 32}.x", "x" * 32])
def test_a_forged_folder_among_the_taken_ones_is_left_and_named(watched, log, name):
    forged = watched.folder / "taken" / name.replace("/", ":")
    forged.mkdir(parents=True)
    (forged / "log.npy").write_bytes(b"log")
    watched.look(3)
    assert ["is not of this program" in line["reason"] for line in log("watched-waits")] == [True]
    assert (watched.scans(), (forged / "log.npy").read_bytes()) == ([], b"log")


def test_a_folder_that_is_away_is_waited_for_and_said_once(watched, log):
    watched.folder.rename(watched.folder.with_name("away"))
    watched.look(3)
    assert len(log("watched-waits")) == 1
    watched.folder.with_name("away").rename(watched.folder)
    watched.put("log.npy", b"log")
    watched.settle()
    assert watched.contents() == {"log.npy": b"log"}


class PoisonedScans(Scans):
    def accept(self, spec, *given, **options):
        if spec.name.startswith("poison"):
            raise RuntimeError("a defect")
        return super().accept(spec, *given, **options)


def test_files_at_which_something_fails_keep_no_other_waiting(watched, log):
    store = watched.store
    right, store.scans = store.scans, PoisonedScans(store.database, store.files, store.places)
    for number in range(3):
        os.utime(watched.put(f"poison {number}.npy", b"%d" % number), (0, 0))
    watched.put("log.npy", b"log")
    watched.settle()
    assert watched.contents() == {"log.npy": b"log"}
    assert len(log("watched-waits")) == 3
    store.scans = right
    watched.look(2, after_s=WAIT_S)
    assert len(watched.contents()) == 4


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
def test_an_unreadable_file_keeps_no_other_waiting(watched, log):
    watched.put("closed.npy", b"x").chmod(0)
    watched.put("open.npy", b"open")
    watched.settle()
    assert watched.contents() == {"open.npy": b"open"}
    assert len(log("watched-waits")) == 1


def test_a_deleted_phantom_is_waited_for(watched, log):
    watched.change(exceptions=[], phantom_id="gone")
    watched.put("log.npy", b"log")
    watched.settle()
    assert [line["reason"] for line in log("watched-waits")] == ["there is no phantom 'gone'"]
    watched.change(phantom_id=None)
    watched.look(2, after_s=WAIT_S)
    assert watched.contents() == {"log.npy": b"log"}


def test_of_two_takers_one_takes_and_the_other_goes_on_when_it_ends(watched):
    other = watched.new_taker()
    watched.put("log.npy", b"log")
    watched.look()
    for _ in range(3):
        watched.now_s += 10.0
        other.look()
        other.wait()
    assert watched.scans() == []
    watched.taker.close()
    watched.taker = other
    watched.settle()
    assert watched.contents() == {"log.npy": b"log"}


def test_a_folder_that_is_no_longer_allowed_is_left(watched, log):
    watched.store.settings.watch_folders[:] = [watched.folder.parent / "others"]
    watched.put("log.npy", b"log")
    watched.look(3, after_s=10.0)
    assert watched.left() == ["log.npy"]
    assert "does not allow" in log("watched-waits")[0]["reason"]


def test_a_scanner_gets_an_allowed_folder_of_its_own(watched, tmp_path):
    scanners, root = watched.store.scanners, watched.folder.parent
    (root / "link").symlink_to(tmp_path)
    for folder, sentence in {
        tmp_path / "elsewhere": f"allows {root}$",
        root.with_name("scanners-2"): f"allows {root}$",
        root / "link/line-3": f"{root}/link is a link: name the folder itself",
        watched.folder: f"watched folder of scanner '{watched.scanner_id}'",
        watched.folder / "taken": "is, holds or lies in",
        root: "is, holds or lies in",
    }.items():
        with pytest.raises(Invalid, match=sentence):
            scanners.create(spec(folder))
    other = scanners.create(spec(root / "line-3"))
    with pytest.raises(Invalid, match="is, holds or lies in"):
        scanners.update(other.id, spec(watched.folder))
    # What was allowed before keeps nobody from changing something else.
    watched.store.settings.watch_folders.clear()
    renamed = scanners.update(other.id, spec(root / "line-3").model_copy(update={"name": "Line 3"}))
    assert renamed.watched_folder.folder == str(root / "line-3")


def _watch_until_killed(settings: StorageSettings) -> None:
    taker = WatchedFolders(Store(settings), threading.Event(), time.monotonic)
    while True:
        taker.look()
        time.sleep(0.005)


@pytest.mark.slow
def test_files_under_kills_of_two_processes_are_each_taken_once(watched):
    random = Random(7)  # noqa: S311 - no secret
    watched.change(still_for_s=0.01)
    contents = {f"log-{number}.npy": random.randbytes(300_000) for number in range(FILES)}
    for name, content in contents.items():
        watched.put(name, content)
    watched.taker.close()
    fork, kills = multiprocessing.get_context("forkserver"), 0
    fork.set_forkserver_preload([__name__, "sawmill_worker.watched_folders"])
    while watched.left() or watched.taken():
        processes = [fork.Process(target=_watch_until_killed, args=(watched.store.settings,)) for _ in range(2)]
        for process in processes:
            process.start()
        # Longer and longer, so that a busy machine gets somewhere too.
        time.sleep(random.uniform(0.03, 0.3) * 1.05**kills)
        for process in processes:
            os.kill(process.pid, signal.SIGKILL)
            process.join()
        watched.read()
        kills += 1
    assert (watched.contents(), len(watched.scans())) == (contents, FILES)
    assert kills > 3  # eight files are taken at a time, and removed once they have been read


def test_the_page_has_each_field_and_its_example_is_taken():
    page = (Path(__file__).parents[2] / "docs/do/watched-folder.md").read_text()
    [example] = re.findall(r"^```json\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    watched = ScannerRequest.model_validate_json(example, strict=True).watched_folder
    assert watched.files_named("phantom 1.h5").phantom_id == "l-shape"
    assert (watched.files_named("log.h5").phantom_id, watched.files_named("log.npy")) == (None, None)
    [table] = re.findall(r"^\| field \|.*?\n\n", page, re.MULTILINE | re.DOTALL)
    assert set(WatchedFolder.model_fields) <= set(re.findall(r"`([a-z_]+)`", table))
