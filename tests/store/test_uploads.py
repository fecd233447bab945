"""Uploads that can be resumed, on each database."""

import hashlib
from typing import Any

import pytest

from sawmill_contracts import kinds
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.acting import Actor, acting_as
from sawmill_platform.contracts.uploads import Upload, UploadAsk, UploadState
from sawmill_platform.errors import Conflict, NotFound, StorageFull
from sawmill_platform.files.upload_stream import STEP_BYTES, AsSent
from sawmill_platform.keys.repeats import KeptAnswer, KeyedRequest
from sawmill_platform.uploads.upload_store import UploadQuota, Uploads, WrongOffset
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind

CONTENT = b"0123456789"
QUOTA = UploadQuota(3, 25, 40)


def create(store: Store, **given: Any) -> Upload:
    return store.uploads.create(UploadAsk(size_bytes=len(CONTENT), **given), QUOTA)


def send(store: Store, upload: Upload, first: int, end: int, *, content: bytes = CONTENT) -> Upload:
    part = store.uploads.begin_part(upload.id, first)
    part.take(AsSent(), content[first:end], commits=True)
    part.finish(AsSent())
    if not part.missing_bytes:
        part.complete()
    part.close()
    return store.uploads.get(upload.id)


def test_parts_become_a_file_that_is_used_once_with_the_scan_that_is_made_of_it(store, scanner):
    upload = create(store, sha256=hashlib.sha256(CONTENT).hexdigest())
    assert store.uploads.promised_bytes() == 10
    assert send(store, upload, 0, 4).offset_bytes == 4
    with pytest.raises(Conflict, match="4 of 10 bytes have come"):
        store.uploads.received(upload.id)
    with pytest.raises(WrongOffset, match="goes on at 4, not at 3"):
        store.uploads.begin_part(upload.id, 3)
    assert send(store, upload, 4, 10).state is UploadState.COMPLETE
    assert store.uploads.promised_bytes() == 0
    with pytest.raises(NotFound):
        store.scans.accept(
            ScanSpec(scanner_id="nowhere", data=DataKind.COUNTS), received := store.uploads.received(upload.id)
        )
    assert not received.path.exists()
    both = [store.uploads.received(upload.id) for _ in range(2)]
    spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS)
    scan = store.scans.accept(spec, both[0])
    assert (scan.size_bytes, scan.sha256) == (10, upload.sha256)
    with pytest.raises(Conflict, match="has been used"):
        store.scans.accept(spec, both[1])
    assert store.uploads.get(upload.id).used_by == f"/v1/scans/{scan.id}"
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
    upload = store.uploads.create(UploadAsk(size_bytes=len(content)), UploadQuota(1, len(content), len(content)))
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


def test_an_upload_that_stands_still_for_a_day_goes(clocked_store, clock):
    still, going_on = create(clocked_store), create(clocked_store)
    clock.advance(hours=23)
    send(clocked_store, going_on, 0, 3)
    clock.advance(hours=2)
    assert list(clocked_store.uploads.remove_expired()) == [still.id]
    assert clocked_store.uploads.get(going_on.id).offset_bytes == 3
