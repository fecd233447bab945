"""Threads of one process that write to SQLite at the same time, and room that a cancellation takes of a full disk."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from emptied_databases import sqlite_alone
from live_service import wait_until, write_lock

from sawmill_platform.database.database import PIECE_BYTES, SPARE_BYTES
from sawmill_platform.errors import StorageUnavailable

pytestmark = [pytest.mark.slow, sqlite_alone]


def test_writers_wait_as_long_as_one_after_the_other_has_its_turn(store):
    # Together they take longer than a database may that does not answer.
    together = threading.Barrier(13, timeout=60)

    def write(_):
        together.wait()
        with store.database.write():
            time.sleep(0.3)

    with ThreadPoolExecutor(13) as pool:
        list(pool.map(write, range(13)))


def test_writers_behind_one_that_does_not_end_are_refused_and_those_after_it_are_not(store, scanner):
    begun, enough = threading.Event(), threading.Event()

    def hold():
        with store.database.write():
            begun.set()
            assert enough.wait(60)

    with ThreadPoolExecutor(1) as pool:
        holder = pool.submit(hold)
        assert begun.wait(60)
        with pytest.raises(StorageUnavailable, match="another request has kept it"):
            store.scanners.delete(scanner.id)
        enough.set()
        holder.result(60)
    store.scanners.delete(scanner.id)


def test_all_that_wait_for_another_process_are_refused_once_the_first_of_them_is(store, scanner):
    def is_deleted(_=None):
        try:
            store.scanners.delete(scanner.id)
        except StorageUnavailable:
            return False
        return True

    with write_lock(store.files.folder / "sawmill.db"), ThreadPoolExecutor(20) as pool:
        assert not any(pool.map(is_deleted, range(20)))
    wait_until(is_deleted)


def test_each_cancellation_gets_a_piece_and_the_room_is_taken_again_when_there_is_some(store, upload):
    spare = store.files.folder / "sawmill.db.spare"
    jobs = [upload(store).job_id for _ in range(2)]
    store.jobs.request_cancel(jobs[0])
    store.fill_spare_room()
    assert spare.stat().st_blocks * 512 >= SPARE_BYTES == spare.stat().st_size
    store.jobs.request_cancel(jobs[1])
    assert spare.stat().st_size == SPARE_BYTES - 2 * PIECE_BYTES
    store.fill_spare_room()
    assert spare.stat().st_size == SPARE_BYTES


def test_a_disk_that_counts_as_full_keeps_its_last_room_for_others(store, full_disk):
    full_disk(store.settings.disk_reserve_bytes + SPARE_BYTES - 1)
    store.fill_spare_room()
    assert not (store.files.folder / "sawmill.db.spare").exists()
