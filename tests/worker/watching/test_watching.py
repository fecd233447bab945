"""`sawmill watch` against a service that answers over HTTP: each file once, each at its end, each trouble said once."""

import errno
import hashlib
import json
import os
import signal
import threading
import time
from contextlib import contextmanager
from random import Random

import pytest
import structlog
from plain_logs import log_plainly
from typer.testing import CliRunner
from watching_process import kill, no_progress, watchers

from sawmill_command.commands import main
from sawmill_platform.contracts.keys import KeyAsk, Scope
from sawmill_store.scans import Scans
from sawmill_worker.watching.command import CannotWatch
from sawmill_worker.watching.folder import Folder
from sawmill_worker.watching.news import News
from sawmill_worker.watching.service import Service
from sawmill_worker.watching.settings import read_settings
from sawmill_worker.watching.stopping import Stop

BAD = b"no scan"
FILES = 12


@pytest.fixture
def log():
    """Gives the events of a name that have been logged since it was asked last."""
    with structlog.testing.capture_logs() as entries:

        def lines(event):
            found = [entry for entry in entries if entry["event"] == event]
            entries[:] = [entry for entry in entries if entry["event"] != event]
            return found

        yield lines


@contextmanager
def stepping(watched):
    """A folder that goes on step by step."""
    watching, stop = read_settings(watched.settings), Stop()
    with Service(watching, stop) as service:
        folder = Folder(watching.folders[0], service, News(), stop, no_progress)

        def step(rounds=1):
            for _ in range(rounds):
                folder.go_on(look=True)
                time.sleep(0.01)

        with folder.locked():
            yield step


@contextmanager
def scan_held(watched):
    """A folder that goes on step by step, once the service has a scan of `log.npy`, which it does not read yet."""
    watched.running.reads.clear()
    watched.put("log.npy", b"log")
    with stepping(watched) as step:
        while not watched.scans():
            step()
        yield step


@pytest.mark.slow
def test_files_under_kills_are_each_taken_once(watched, tmp_path):
    random = Random(7)  # noqa: S311 - no secret
    contents = {f"log-{number}.npy": random.randbytes(5_000) for number in range(FILES)}
    for name, content in contents.items():
        watched.put(name, content)
    kills = 0
    with watchers(watched.settings, tmp_path / "watch.log") as start:
        while len(watched.ended("done")) < FILES or watched.records():
            process_id = start()
            # Longer and longer, so that a busy machine gets somewhere too.
            time.sleep(random.uniform(0.03, 0.25) * 1.03**kills)
            kill(process_id)
            kills += 1
    assert kills >= 3
    assert watched.ended("done") == contents
    assert watched.contents() == contents
    ids = {scan.name: scan.id for scan in watched.scans()}
    assert {name: watched.note(name)["scan_id"] for name in contents} == ids
    assert watched.left() == []


def test_a_file_comes_to_its_end_as_its_settings_say(watched, log):
    watched.put("phantom 1.npy", b"p" * 100)
    watched.put("log.npy", b"l" * 100)
    assert watched.once()
    phantom, wood = sorted(watched.scans(), key=lambda scan: scan.name, reverse=True)
    assert (phantom.name, phantom.phantom_id, wood.phantom_id) == ("phantom 1.npy", "l-shape", None)
    assert phantom.angles_deg == "0:120"
    assert watched.running.store.jobs.get(wood.job_id).priority == "batch"
    assert watched.ended("done") == {"phantom 1.npy": b"p" * 100, "log.npy": b"l" * 100}
    note = watched.note("log.npy")
    assert (note["scan_id"], note["job_id"]) == (wood.id, wood.job_id)
    assert (note["sha256"], note["size_bytes"]) == (hashlib.sha256(b"l" * 100).hexdigest(), 100)
    (ended,) = log("ended")
    assert (ended["done"], ended["refused"], ended["left"]) == (2, 0, 0)


def test_what_is_no_scan_goes_to_refused_with_the_reason(watched, log):
    watched.put("bad.npy", BAD)
    watched.put("page.npy", b"<html>" + b"x" * 2000)
    watched.put("big.npy", b"x" * 100_001)
    watched.put("empty.npy", b"")
    watched.put("empty.npy.done", b"")
    watched.put("good.npy", b"g")
    assert not watched.once()
    assert watched.contents() == {"bad.npy": BAD, "good.npy": b"g"}
    assert watched.ended("done") == {"good.npy": b"g"}
    assert set(watched.ended("refused")) == {"bad.npy", "page.npy", "big.npy", "empty.npy"}
    reason, code, scan, *_ = watched.reason("bad.npy").splitlines()
    (bad,) = (each for each in watched.scans() if each.name == "bad.npy")
    assert (reason, code, scan) == ("the file is no scan", "code: unknown-format", f"scan: {bad.id}")
    assert "code: unsupported-media-type" in watched.reason("page.npy")
    assert "code: upload-too-large" in watched.reason("big.npy")
    assert "code: empty-file" in watched.reason("empty.npy")
    refused = log("refused")
    assert max(line["to_look_at"] for line in refused) == 4
    assert (watched.left(), watched.records()) == ([], [])


def test_a_scan_that_is_read_at_once_is_named_beside_its_refused_file(watched):
    watched.put("bad.npy", BAD)
    watched.running.reads_before_answers = True
    assert not watched.once()
    (bad,) = watched.scans()
    assert f"scan: {bad.id}" in watched.reason("bad.npy").splitlines()


def test_equal_contents_and_a_name_used_again_are_scans_of_their_own(watched):
    watched.put("a.npy", b"same")
    watched.put("b.npy", b"same")
    assert watched.once()
    watched.put("a.npy", b"same")
    assert watched.once()
    watched.put("a.npy", b"another")
    assert watched.once()
    assert sorted(scan.name for scan in watched.scans()) == ["a.npy", "a.npy", "a.npy", "b.npy"]
    assert watched.ended("done") == {"a.npy": b"same", "b.npy": b"same", "a-2.npy": b"same", "a-3.npy": b"another"}
    assert len({watched.note(name)["scan_id"] for name in watched.ended("done")}) == 4


def test_a_file_that_grows_waits_and_a_mark_says_that_it_is_whole(watched):
    watched.describe(still_for_s=60.0)
    stop = threading.Event()
    growing = watched.put("slow.npy", b"1")

    def write():
        with growing.open("ab") as file:
            while not stop.wait(0.01):
                file.write(b"1")
                file.flush()

    writer = threading.Thread(target=write)
    writer.start()
    watched.put("fast.npy", b"2").with_name("fast.npy.done").touch()
    with stepping(watched) as step:
        step(20)
        stop.set()
        writer.join()
        assert "slow.npy" not in watched.contents()
        content = growing.read_bytes()
        watched.put("slow.npy.done", b"")
        while watched.left() or watched.records():
            step()
    assert watched.contents() == {"fast.npy": b"2", "slow.npy": content}
    assert watched.left() == []


def test_a_mark_that_came_late_says_nothing_of_the_next_file_of_its_name(watched):
    watched.put("scan.npy", b"first")
    assert watched.once()
    watched.describe(still_for_s=False)
    late = watched.put("scan.npy.done", b"")
    half = watched.put("scan.npy", b"sec")
    os.utime(late, ns=(0, half.stat().st_mtime_ns - 1))
    assert not watched.once()
    assert watched.left() == ["scan.npy", "scan.npy.done"]
    half.write_bytes(b"second")
    late.touch()
    assert watched.once()
    assert [watched.running.content(scan) for scan in watched.scans()] == [b"first", b"second"]


def test_a_file_that_is_written_to_before_it_was_sent_is_sent_as_it_is_at_last(watched, log):
    path = watched.put("early.npy", b"first ")
    with path.open("ab") as writer:
        watched.put("early.npy.done", b"")
        watched.describe(scanner_id="nobody")
        assert not watched.once()  # taken, and not made a scan
        assert "scanner-not-found" in {line["code"] for line in log("waits")}
        writer.write(b"and last")
        writer.flush()
        watched.describe()
        with stepping(watched) as step:
            while watched.records():
                step()
    assert "file-changed" in {line["code"] for line in log("waits")}
    assert watched.contents() == {"early.npy": b"first and last"}
    assert watched.ended("done") == {"early.npy": b"first and last"}


def test_a_file_that_is_written_to_after_its_scan_was_made_is_for_somebody_to_look_at(watched):
    watched.running.reads.clear()
    path = watched.put("early.npy", b"first ")
    with path.open("ab") as writer, stepping(watched) as step:
        while not watched.scans():
            step()
        writer.write(b"and last")
        writer.flush()
        watched.running.reads.set()
        while watched.records():
            step()
    (scan,) = watched.scans()
    assert watched.ended("refused") == {"early.npy": b"first and last"}
    assert f"scan {scan.id} has what it was then" in watched.reason("early.npy")


def test_a_file_that_became_shorter_after_it_was_summed_up_is_sent_as_it_is(watched):
    """As after a kill between the record of its sum and the answer to its upload."""
    identifier, content = "0" * 32, b"shorter"
    taking = watched.folder / "taken" / identifier
    taking.mkdir(parents=True)
    (taking / "log.npy").write_bytes(content)
    record = {"id": identifier, "name": "log.npy", "signature": [50, 0], "taken_at": "2026-11-23T00:00:00+00:00"}
    record["sha256"] = hashlib.sha256(b"x" * 50).hexdigest()
    taking.with_suffix(".json").write_text(json.dumps(record))
    with stepping(watched) as step:
        while watched.records():
            step()
    assert watched.ended("done") == {"log.npy": content}
    assert watched.contents() == {"log.npy": content}


def test_a_touched_file_of_equal_bytes_has_not_changed(watched):
    with scan_held(watched) as step:
        (taken,) = (watched.folder / "taken").glob("*/log.npy")
        os.utime(taken, (1, 1))
        watched.running.reads.set()
        while watched.records():
            step()
    assert watched.ended("done") == {"log.npy": b"log"}


def test_a_scan_is_found_again_when_the_upload_that_it_was_made_of_is_forgotten(watched):
    """As after a kill between the service's answer and the record, and two days without the watcher."""
    with scan_held(watched):
        (record,) = watched.records()
    taking = json.loads(record.read_text())
    for forgotten in ({"scan_id": None}, {"scan_id": None, "upload_id": "0" * 32}):
        record.write_text(json.dumps(taking | forgotten))
        with stepping(watched) as step:
            step()
        assert json.loads(record.read_text())["scan_id"] == taking["scan_id"]
    # And where nothing was made of it, it is sent again.
    watched.running.reads.set()
    record.write_text(
        json.dumps(taking | {"scan_id": None, "upload_id": "0" * 32, "upload_began": "2099-01-01T00:00:00Z"})
    )
    with stepping(watched) as step:
        while watched.records():
            step()
    assert len(watched.scans()) == 2


def test_a_process_killed_between_two_steps_of_a_move_is_finished(watched):
    with scan_held(watched):
        (record,) = watched.records()
    kept = record.read_bytes()
    watched.running.reads.set()
    assert watched.once()
    (place,) = (watched.folder / "done").glob("*/log.npy")
    taking = record.with_suffix("")
    # The record is still there; then, the file too, and its sidecar is written.
    record.write_bytes(kept)
    assert watched.once()
    assert watched.records() == []
    record.write_bytes(kept)
    taking.mkdir()
    place.rename(taking / "log.npy")
    assert watched.once()
    assert watched.ended("done") == {"log.npy": b"log"}
    # The record alone: the file was not yet moved.
    watched.put("log.npy", b"next")
    record.write_text(json.dumps(json.loads(kept) | {"scan_id": None, "upload_id": None}))
    assert watched.once()
    assert watched.ended("done") == {"log.npy": b"log", "log-2.npy": b"next"}


def test_a_deleted_scan_and_a_cancelled_job_are_for_somebody_to_look_at(watched):
    with scan_held(watched) as step:
        (scan,) = watched.scans()
        watched.running.store.jobs.request_cancel(scan.job_id)
        step()
    assert "code: cancelled" in watched.reason("log.npy")
    watched.running.reads.set()


def test_other_folders_on_another_file_system_get_whole_files(watched, tmp_path, monkeypatch):
    if tmp_path.stat().st_dev == watched.folder.stat().st_dev:
        pytest.skip("there is one file system here")
    for name in ("done", "refused"):
        (tmp_path / name).mkdir()
    watched.describe(done=str(tmp_path / "done"), refused=str(tmp_path / "refused"))

    def not_owner(*_, **__):
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "utime", not_owner)  # as on a share whose files belong to another user
    content = bytes(range(256)) * 300
    watched.put("log.npy", content)
    watched.put("bad.npy", BAD)
    assert not watched.once()
    (done,), (refused,) = tmp_path.glob("done/*/log.npy"), tmp_path.glob("refused/*/bad.npy")
    assert (done.read_bytes(), refused.read_bytes()) == (content, BAD)
    assert (watched.left(), watched.records(), list((watched.folder / "taken").glob("*/*"))) == ([], [], [])


def test_a_mark_that_is_a_link_marks_nothing_and_its_file_is_taken_once_it_stands_still(watched, log):
    watched.put("scan.npy", b"1")
    (watched.folder / "scan.npy.done").symlink_to("scan.npy.done")
    with stepping(watched) as step:
        step(5)
    assert [line["file"].rpartition("/")[2] for line in log("left-alone")] == ["scan.npy.done"]
    assert len(watched.scans()) == 1


def test_links_folders_and_names_that_nothing_matches_are_left_alone_and_named_once(watched, log, tmp_path):
    secret = tmp_path / "secret.npy"
    secret.write_bytes(b"secret")
    (watched.folder / "link.npy").symlink_to(secret)
    (watched.folder / "folder.npy").mkdir()
    os.mkfifo(watched.folder / "pipe.npy")
    for name in ("notes.txt", ".hidden.npy", "a.npy.tmp", "b.npy.part", "c.npy~", "x" * 201 + ".npy"):
        watched.put(name, b"x")
    with stepping(watched) as step:
        step(5)
    alone = sorted(line["file"].rpartition("/")[2] for line in log("left-alone"))
    assert alone == ["folder.npy", "link.npy", "notes.txt", "pipe.npy", "x" * 201 + ".npy"]
    assert watched.scans() == []


def test_a_link_in_place_of_a_folder_is_refused(watched, tmp_path):
    (watched.folder / "done").symlink_to(tmp_path)
    with pytest.raises(CannotWatch, match="must be a folder and no link"):
        watched.once()


FORGED = {
    "name": {"name": "../../elsewhere/secret.npy"},
    "id": {"id": "/elsewhere"},
    "link": {},
    "day": {"taken_at": "../../../x"},
    "upload": {"upload_id": "../scans/example"},
    "scan": {"scan_id": "../keys"},
    "kind": {"name": 5},
    "signature": {"signature": []},
}


@pytest.mark.parametrize("forged", FORGED)
def test_a_forged_record_leads_nowhere(watched, tmp_path, log, forged):
    (tmp_path / "secret.npy").write_bytes(b"secret")
    taken = watched.folder / "taken"
    taken.mkdir()
    record = {"id": "0" * 32, "name": "secret.npy", "signature": [6, 0], "taken_at": "2026-11-23T00:00:00+00:00"}
    path = taken / f"{record['id']}.json"
    if forged == "link":
        path.with_suffix("").symlink_to(tmp_path)
    path.write_text(json.dumps(record | FORGED[forged]))
    assert not watched.once()
    assert "is no record of a file that was taken" in log("waits")[0]["reason"]
    assert watched.scans() == []


@pytest.mark.parametrize("scheme", ["https", "HTTPS"])
def test_certificates_that_cannot_be_read_are_named(watched, scheme):
    watched.document |= {"service": f"{scheme}://127.0.0.1:9", "ca_file": "/nowhere/ca.pem"}
    watched.describe()
    with pytest.raises(CannotWatch, match=r"no certificates \(PEM\) can be read: No such file.*'/nowhere/ca.pem'"):
        watched.once()


def test_a_second_watcher_is_refused_with_the_first_one_s_process(watched):
    with stepping(watched), pytest.raises(CannotWatch, match=f"is watched by process {os.getpid()} already"):
        watched.once()


def test_an_absent_service_is_waited_for_and_said_once(watched, log):
    watched.put("log.npy", b"log")
    right = watched.document["service"]
    watched.document["service"] = "http://127.0.0.1:9"
    watched.describe()
    assert not watched.once()
    assert [line["code"] for line in log("waits")] == ["no-answer"]
    watched.document["service"] = right
    watched.describe()
    assert watched.once()
    assert watched.contents() == {"log.npy": b"log"}


class PoisonedScans(Scans):
    """Has a defect at which some scans fail."""

    def accept(self, spec, *given, **options):
        if spec.name.startswith("poison"):
            raise RuntimeError("a defect")
        return super().accept(spec, *given, **options)


@pytest.fixture
def right_scans(watched):
    """Those of the service's store, which has a defect until they are put back."""
    store = watched.running.store
    right, store.scans = store.scans, PoisonedScans(store.database, store.files, store.places)
    yield right
    store.scans = right


def test_files_at_which_the_service_fails_keep_no_other_waiting(watched, right_scans, log):
    for number in range(3):
        os.utime(watched.put(f"poison {number}.npy", b"%d" % number), (0, 0))
    watched.put("log.npy", b"log")
    assert not watched.once()
    assert watched.contents() == {"log.npy": b"log"}
    assert [line["code"] for line in log("waits")] == ["internal"] * 3
    watched.running.store.scans = right_scans
    assert watched.once()
    assert len(watched.contents()) == 4


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
def test_an_unreadable_file_keeps_no_other_waiting(watched, log):
    watched.put("closed.npy", b"x").chmod(0)
    watched.put("open.npy", b"open")
    assert not watched.once()
    assert watched.contents() == {"open.npy": b"open"}
    assert [line["code"] for line in log("waits")] == ["unreadable"]


def test_a_key_of_scope_submit_is_enough_and_a_smaller_one_is_waited_for(watched, log, tmp_path):
    keys = watched.running.store.keys
    small = keys.create(KeyAsk(name="display", scope=Scope.READ))
    right = keys.create(KeyAsk(name="scanner software", scope=Scope.SUBMIT))
    key_file = tmp_path / "key"
    key_file.write_text(small.secret)
    watched.document["key_file"] = str(key_file)
    watched.describe()
    watched.put("log.npy", b"log")
    assert not watched.once()
    assert [line["code"] for line in log("waits")] == ["scope-too-small"]
    key_file.write_text(f"{right.secret}\n")
    assert watched.once()
    assert watched.running.store.jobs.get(watched.scans()[0].job_id).asked_by == "scanner software"


@pytest.fixture
def command():
    """Run `sawmill watch` in this process, whose log it makes its own."""

    def run(*words):
        return CliRunner().invoke(main, ["watch", *map(str, words)], terminal_width=500)

    yield run
    log_plainly()


def test_check_says_what_would_be_done_and_does_nothing(watched, command):
    watched.put("phantom.npy", b"p")
    (watched.folder / "taken").mkdir()
    shown = command("--check", watched.settings)
    assert shown.exit_code == 0, shown.output
    assert f"scanner {watched.scanner_id} is 'Line 2'" in shown.output
    assert "phantom.npy would be sent with" in shown.output
    assert "phantom_id=l-shape" in shown.output
    watched.describe(scanner_id="line-9")
    wrong = command("--check", watched.settings)
    assert wrong.exit_code == 1
    assert "there is no scanner 'line-9'; the newest are " in wrong.output
    assert (watched.left(), list((watched.folder / "taken").iterdir())) == (["phantom.npy"], [])


def test_sigterm_ends_in_order(watched, tmp_path, until):
    watched.put("log.npy", b"log")
    with watchers(watched.settings, tmp_path / "watch.log") as start:
        process_id = start()
        until(lambda: watched.ended("done") and not watched.records())
        os.kill(process_id, signal.SIGTERM)
        until(lambda: '"event": "ended"' in (tmp_path / "watch.log").read_text())
    ended = json.loads((tmp_path / "watch.log").read_text().splitlines()[-1])
    assert (ended["done"], ended["left"], ended["level"]) == (1, 0, "info")


def test_once_as_a_command_has_an_exit_code(watched, command):
    watched.put("log.npy", b"log")
    assert command("--once", watched.settings).exit_code == 0
    watched.put("bad.npy", BAD)
    assert command("--once", watched.settings).exit_code == 1
    watched.describe(folder=f"{watched.folder}-gone")
    gone = command(watched.settings)
    assert gone.exit_code == 1
    assert "is not there, or no folder" in gone.output
    watched.describe(done_sufix=".ok")
    wrong = command(watched.settings)
    assert wrong.exit_code == 2
    assert "folders.0.done_sufix is not a known field: 'done_suffix' is" in wrong.output
