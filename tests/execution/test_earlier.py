"""What waited for its turn while the same was computed is answered by its worker; so is what is asked for then."""

import io

import numpy as np
import pytest

from sawmill_worker.contracts.events import EventKind
from sawmill_worker.contracts.inspections import InspectionOptions
from sawmill_worker.contracts.jobs import JobState
from sawmill_worker.storage.software import software

pytestmark = pytest.mark.slow


@pytest.fixture
def inspect(store):
    buffer = io.BytesIO()
    np.save(buffer, np.ones((12, 1, 16), np.float32))

    def ask(**fresh):
        return store.inspections.accept_file(
            InspectionOptions(), store.files.receive([buffer.getvalue()], max_bytes=10**5), **fresh
        )

    return ask


def fates(store, inspection):
    return [event.what for event in store.events.of_job(inspection.job_id)]


def test_a_second_in_the_queue_is_answered_by_the_worker_and_a_third_at_once(store, reader, inspect):
    first, second, fresh = inspect(), inspect(), inspect(fresh=True)
    assert [reader.run_next() for _ in range(3)] == [JobState.SUCCEEDED] * 3
    done = [store.inspections.get(each.id) for each in (first, second, fresh)]
    assert [each.answered_from for each in done] == [None, first.id, None]
    assert done[0].result == done[1].result
    assert done[0].result.reading.shape.views == 12
    assert fates(store, second) == [EventKind.STARTED, EventKind.SUCCEEDED]
    assert store.events.of_job(second.job_id)[-1].detail == {"answered_from": first.id}
    third = inspect()
    assert (third.state, third.answered_from, third.result) == (JobState.SUCCEEDED, fresh.id, done[2].result)
    assert reader.run_next() is None
    assert list((store.files.folder / "attempts").iterdir()) == []
    process = reader._take_ready()
    process.end(1.0)
    assert process.software == software(), "a process says which software it has loaded"
