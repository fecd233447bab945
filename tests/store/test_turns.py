"""Groups take turns in the queue, so that nobody waits behind another line's thousands."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import pytest
from sqlalchemy import event

from sawmill_contracts import kinds
from sawmill_platform.contracts.jobs import Priority
from sawmill_platform.errors import StorageUnavailable
from sawmill_platform.jobs.wait_estimate import Selection
from sawmill_store.store import Store

pytestmark = pytest.mark.clocked


def claimed(store, number, selection=Selection()):  # noqa: B008 - frozen
    """The groups whose jobs are claimed next."""
    claims = [store.jobs.claim("test", selection) for _ in range(number)]
    return [claim and claim.job_id.partition("-")[0] for claim in claims]


@pytest.mark.dialect
def test_a_batch_of_one_line_does_not_delay_another_line_s_job(store, add_jobs):
    add_jobs(200, kinds.RECONSTRUCT, group_id="a")
    assert claimed(store, 2) == ["a", "a"]
    add_jobs(1, kinds.RECONSTRUCT, group_id="b")
    assert claimed(store, 2) == ["b", "a"]
    add_jobs(3, kinds.RECONSTRUCT, group_id="b")
    add_jobs(2, kinds.RECONSTRUCT, group_id="c")
    line = store.jobs.waiting_in_line(limit=8)
    assert [job.queue_position for job in line] == list(range(8))
    expected = [job.id.partition("-")[0] for job in line]
    assert expected == ["c", "b", "a", "c", "b", "a", "b", "a"]
    assert claimed(store, 8) == expected


@pytest.mark.dialect
def test_a_job_is_read_while_another_line_s_first_job_is_added(store, add_jobs):
    add_jobs(1, kinds.RECONSTRUCT, group_id="a")
    [waiting] = store.jobs.waiting_in_line()
    adding = iter(["b"])

    def add(*given):
        if "job_turns" in given[2]:  # the second of two statements: the first one has read the jobs that wait
            for group_id in adding:
                add_jobs(1, kinds.RECONSTRUCT, group_id=group_id)

    event.listen(store.database.engine, "before_cursor_execute", add)
    assert store.jobs.get(waiting.id).queue_position == 0
    assert next(adding, None) is None
    assert len(store.jobs.waiting_in_line()) == 2


def test_turns_are_of_a_priority_and_of_the_workers_of_a_lane(store, add_jobs):
    add_jobs(3, kinds.RECONSTRUCT, group_id="a", priority=Priority.BATCH)
    add_jobs(2, kinds.RECONSTRUCT, group_id="b", priority=Priority.BATCH)
    add_jobs(1, kinds.RECONSTRUCT, group_id="a")
    add_jobs(1, kinds.RECONSTRUCT, group_id="b")
    add_jobs(3, kinds.CALIBRATE, group_id="a", short=True)
    short = Selection(short=True)
    assert claimed(store, 4, short) == ["a", "a", "a", None]
    assert claimed(store, 7) == ["a", "b", "a", "b", "a", "b", "a"]


@pytest.mark.dialect
def test_a_worker_takes_the_kinds_and_groups_that_it_was_given(store, add_jobs):
    add_jobs(2, kinds.RECONSTRUCT, group_id="a")
    add_jobs(1, kinds.CALIBRATE, group_id="b")
    add_jobs(2, kinds.RECONSTRUCT, group_id="b")
    assert claimed(store, 2, Selection(kinds=frozenset({kinds.CALIBRATE}))) == ["b", None]
    assert claimed(store, 3, Selection(group_ids=frozenset({"b"}))) == ["b", "b", None]
    assert claimed(store, 3) == ["a", "a", None]


@pytest.mark.dialect
@pytest.mark.slow
def test_many_workers_serve_groups_alike_and_each_job_once(store, add_jobs):
    for group_id in ("a", "b", "c"):
        add_jobs(30, kinds.RECONSTRUCT, group_id=group_id)

    def claim_some(_):
        opened, taken = Store(store.settings), []
        while len(taken) < 10:
            with suppress(StorageUnavailable):  # as a worker does: six keep each other waiting on a slow disk
                taken.append(opened.jobs.claim("racer").job_id)
        opened.close()
        return taken

    with ThreadPoolExecutor(6) as pool:
        taken = [job_id for some in pool.map(claim_some, range(6)) for job_id in some]
    assert len(set(taken)) == 60
    # Half of an equal share at least: on PostgreSQL claims at the same moment see the same turn.
    assert min(Counter(job_id.partition("-")[0] for job_id in taken).values()) >= 10
