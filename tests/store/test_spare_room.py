"""Room that a cancellation takes when the disk is full."""

import pytest
from databases import sqlite_alone

from sawmill_platform.database.database import PIECE_BYTES, SPARE_BYTES

pytestmark = [pytest.mark.slow, sqlite_alone]


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
    free_bytes = store.settings.disk_reserve_bytes + SPARE_BYTES - 1
    full_disk(free_bytes)
    store.fill_spare_room()
    assert not (store.files.folder / "sawmill.db.spare").exists()
