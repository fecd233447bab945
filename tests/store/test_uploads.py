"""Uploads that can be resumed, and answers that are kept for repeats: one transaction with what is answered."""

import hashlib
import os
import signal

import pytest
from results import CONSTANTS

from sawmill_contracts import kinds
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.contracts.uploads import UploadRequest, UploadState
from sawmill_platform.errors import Conflict, NotFound, StorageFull
from sawmill_platform.files.upload_stream import STEP_BYTES, AsSent
from sawmill_platform.keys.repeats import KEPT, KeptAnswer, KeyedRequest
from sawmill_platform.ledger.events import Actor, acting_as
from sawmill_platform.uploads.upload_store import UploadQuota, Uploads
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind

CONTENT = b"0123456789"
QUOTA = UploadQuota(3, 25, 40)


def create(store, **given):
    return store.uploads.create(UploadRequest(size_bytes=len(CONTENT), **given), QUOTA)


def send(store, upload, first, end, *, content=CONTENT):
    part = store.uploads.begin_part(upload.id, first)
    part.take(AsSent(), content[first:end], commits=True)
    part.finish(AsSent())
    if not part.missing_bytes:
        part.complete()
    part.close()
    return store.uploads.get(upload.id)


def test_an_upload_is_used_once_with_the_scan_that_is_made_of_it(store, scanner):
    upload = create(store)
    assert store.uploads.promised_bytes() == 10
    send(store, upload, 0, 4)
    with pytest.raises(Conflict, match="4 of 10 bytes have come"):
        store.uploads.received(upload.id)
    send(store, upload, 4, 10)
    assert store.uploads.promised_bytes() == 0
    nowhere, spec = (ScanSpec(scanner_id=name, data=DataKind.COUNTS) for name in ("nowhere", scanner.id))
    refused, first, second = (store.uploads.received(upload.id) for _ in range(3))
    with pytest.raises(NotFound):
        store.scans.accept(nowhere, refused)
    assert not refused.path.exists()
    scan = store.scans.accept(spec, first)
    with pytest.raises(Conflict, match="has been used"):
        store.scans.accept(spec, second)
    with pytest.raises(Conflict, match=f"has become /v1/scans/{scan.id}"):
        store.uploads.received(upload.id)
    assert list((store.files.folder / "incoming").iterdir()) == []


@pytest.mark.dialect
def test_one_part_comes_at_a_time_and_what_was_not_counted_never_came(store):
    upload = create(store)
    part = store.uploads.begin_part(upload.id, 0)
    part.take(AsSent(), b"dam", commits=False)
    with pytest.raises(Conflict, match="another part"):
        store.uploads.begin_part(upload.id, 0)
    part.close()
    send(store, upload, 0, 3)
    with pytest.raises(Conflict, match="lacks 7 of 10 bytes, but the part has 8"):
        store.uploads.begin_part(upload.id, 3, part_bytes=8)
    too_long = store.uploads.begin_part(upload.id, 3)
    with pytest.raises(Conflict, match="more comes than the 10 bytes"):
        too_long.take(AsSent(), bytes(8), commits=True)
    too_long.close()
    assert send(store, upload, 3, 10).sha256 == hashlib.sha256(CONTENT).hexdigest()


def test_an_upload_whose_sum_was_not_ended_is_completed_by_an_empty_part(store):
    upload = create(store)
    part = store.uploads.begin_part(upload.id, 0)
    part.take(AsSent(), CONTENT, commits=True)
    part.commit()
    part.close()
    with pytest.raises(Conflict, match="send an empty part"):
        store.uploads.received(upload.id)
    send(store, upload, 10, 10)
    assert store.uploads.get(upload.id).state is UploadState.COMPLETE


@pytest.mark.parametrize("sent", [False, True])
def test_a_deleted_upload_takes_no_more_and_is_gone(store, sent):
    upload = create(store)
    part = store.uploads.begin_part(upload.id, 0)
    if sent:
        part.take(AsSent(), CONTENT, commits=True)
        part.finish(AsSent())
    store.uploads.delete(upload.id)
    if not sent:
        part.take(AsSent(), CONTENT, commits=False)
    with pytest.raises(NotFound):
        part.complete() if sent else part.finish(AsSent())
    part.close()
    assert list((store.files.folder / "unfinished").iterdir()) == []


def test_a_part_that_counts_as_a_whole_does_not_take_the_reserve_either(store):
    content = bytes(STEP_BYTES + 10)
    upload = store.uploads.create(UploadRequest(size_bytes=len(content)), UploadQuota(1, len(content), len(content)))
    for commits in (False, True):
        part = Uploads(store.database, store.files, 2**62).begin_part(upload.id, 0)
        with pytest.raises(StorageFull, match="SAWMILL_DISK_RESERVE_BYTES"):
            part.take(AsSent(), content, commits=commits)
        part.close()
    assert send(store, upload, 0, len(content), content=content).state is UploadState.COMPLETE


def test_the_bytes_of_a_used_upload_have_one_name_after_the_commit_and_its_own_where_there_is_none(store, scanner):
    spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS)
    used, kept = create(store), create(store)
    for upload in (used, kept):
        send(store, upload, 0, 10)
    scan = store.scans.accept(spec, store.uploads.received(used.id))
    assert store.files.upload(kinds.INGEST, scan.id).stat().st_nlink == 1
    assert not store.files.unfinished(used.id).exists()

    def refused():
        store.scans.accept(spec, store.uploads.received(kept.id))
        raise Conflict("scan-in-use", "something that comes after it in the same transaction")

    with pytest.raises(Conflict, match="after it"):
        store.repeats.once(KeyedRequest("somebody", "once", "0" * 64), refused, lambda _: KeptAnswer(202, {}, ""))
    assert store.uploads.get(kept.id).state is UploadState.COMPLETE
    again = store.scans.accept(spec, store.uploads.received(kept.id))
    assert store.files.upload(kinds.INGEST, again.id).read_bytes() == CONTENT
    assert list((store.files.folder / "unfinished").iterdir()) == []


def test_an_upload_whose_file_is_lost_says_so(store):
    upload = create(store)
    send(store, upload, 0, 10)
    store.files.unfinished(upload.id).unlink()
    with pytest.raises(Conflict, match="are gone: delete it"):
        store.uploads.received(upload.id)


@pytest.mark.dialect
def test_what_a_key_and_all_may_leave_waiting_is_bounded(store):
    with acting_as(Actor("one", "one")):
        uploads = [create(store) for _ in range(2)]
        with pytest.raises(Conflict, match="uploads of one may have 25 bytes before they are used, and 20 are taken"):
            create(store)
    with acting_as(Actor("two", "two")):
        for _ in range(2):
            create(store)
    with acting_as(Actor("three", "three")), pytest.raises(Conflict, match="all keys may have 40 bytes"):
        create(store)
    with acting_as(Actor("one", "one")):
        store.uploads.delete(uploads[0].id)
    with acting_as(Actor("three", "three")):
        create(store)


@pytest.mark.clocked
def test_an_upload_that_stands_still_for_a_day_goes(store, clock):
    still, going_on = create(store), create(store)
    clock.advance(hours=23)
    send(store, going_on, 0, 3)
    clock.advance(hours=2)
    assert (list(store.uploads.remove_expired()), store.uploads.get(going_on.id).offset_bytes) == ([still.id], 3)


ASKED = KeyedRequest("somebody", "once", "0" * 64)
SPEC = ScannerSpec(name="Line 3", constants=ScannerConstants(**CONSTANTS))


def kept_as(scanner):
    return KeptAnswer(201, {"location": scanner.id}, scanner.model_dump_json())


def made(store, request=ASKED):
    return store.repeats.once(request, lambda: store.scanners.create(SPEC), kept_as)


def test_what_is_refused_within_and_got_over_leaves_the_rest(store):
    def some():
        first = store.scanners.create(SPEC, scanner_id="line-3")
        with pytest.raises(Conflict):
            store.scanners.create(SPEC, scanner_id="line-3")
        assert store.scanners.get("line-3") == first, "what was written is read before the commit"
        return first

    store.repeats.once(ASKED, some, kept_as)
    assert [scanner.id for scanner in store.scanners.page(limit=200).items] == ["line-3"]


@pytest.mark.clocked
@pytest.mark.dialect
def test_an_answer_is_kept_for_its_time_and_then_removed(store, clock):
    first = made(store)
    clock.now += KEPT - (step := KEPT / 1000)
    store.repeats.forget_old()
    assert made(store) == kept_as(first)
    clock.now += step
    assert store.repeats.find(ASKED) is None
    assert made(store).id != first.id
    clock.now += KEPT
    store.repeats.forget_old()
    with store.database.read() as session:
        assert session.connection().exec_driver_sql("SELECT count(*) FROM repeats").scalar() == 0


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["claimed", "made", "committed"])
def test_a_kill_leaves_both_or_neither(store, settings, scanner, moment):
    """The process ends as by SIGKILL: nothing is unwound, and the connection is gone."""
    spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS)

    def accept(store, dies_at=None):
        def make():
            if dies_at == "claimed":
                os.kill(os.getpid(), signal.SIGKILL)
            accepted = store.scans.accept(spec, store.files.receive([b"scan"], max_bytes=10))
            if dies_at == "made":
                os.kill(os.getpid(), signal.SIGKILL)
            return accepted

        return store.repeats.once(ASKED, make, lambda scan: KeptAnswer(202, {}, scan.model_dump_json()))

    child = os.fork()
    if child == 0:
        own = Store(settings)  # a connection is not shared with the parent
        accept(own, moment)
        os.kill(os.getpid(), signal.SIGKILL)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    kept = store.repeats.find(ASKED)
    assert isinstance(accept(store), KeptAnswer) is (moment == "committed") is (kept is not None)
    scan, *others = store.scans.page().items
    assert others == []
    assert len(store.jobs.page().items) == 1
    assert store.files.upload(store.jobs.page().items[0].kind, scan.id).read_bytes() == b"scan"
