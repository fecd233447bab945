"""Answers that are kept for repeats: one transaction with what is answered, on both databases."""

import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from results import CONSTANTS

from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.errors import Conflict
from sawmill_platform.keys.repeats import KEPT, KeptAnswer, KeyedRequest
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind

pytestmark = pytest.mark.slow
ASKED = KeyedRequest("somebody", "once", "0" * 64)
SPEC = ScannerSpec(name="Line 3", constants=ScannerConstants(**CONSTANTS))


def kept_as(scanner):
    return KeptAnswer(201, {"location": scanner.id}, scanner.model_dump_json())


def made(store, request=ASKED):
    return store.repeats.once(request, lambda: store.scanners.create(SPEC), kept_as)


def scanners(store):
    return [scanner.id for scanner in store.scanners.page(limit=200).items]


@pytest.mark.dialect
def test_of_forty_at_once_one_is_made_and_all_get_it(store):
    together = threading.Barrier(40)

    def ask(_):
        together.wait()
        return made(store)

    with ThreadPoolExecutor(40) as pool:
        answers = list(pool.map(ask, range(40)))
    first = [answer for answer in answers if not isinstance(answer, KeptAnswer)]
    assert len(first) == 1
    assert {answer.body for answer in answers if isinstance(answer, KeptAnswer)} == {first[0].model_dump_json()}
    assert scanners(store) == [first[0].id]


def test_what_is_refused_within_and_got_over_leaves_the_rest(store):
    def some():
        first = store.scanners.create(SPEC, scanner_id="line-3")
        with pytest.raises(Conflict):
            store.scanners.create(SPEC, scanner_id="line-3")
        assert store.scanners.get("line-3") == first, "what was written is read before the commit"
        return first

    store.repeats.once(ASKED, some, kept_as)
    assert scanners(store) == ["line-3"]


@pytest.mark.dialect
def test_an_answer_is_kept_for_its_time_and_then_removed(clocked_store, clock):
    first = made(clocked_store)
    clock.now += KEPT - (step := KEPT / 1000)
    clocked_store.repeats.forget_old()
    assert made(clocked_store) == kept_as(first)
    clock.now += step
    assert clocked_store.repeats.find(ASKED) is None
    second = made(clocked_store)
    assert second.id != first.id
    clock.now += KEPT
    clocked_store.repeats.forget_old()
    with clocked_store.database.read() as session:
        assert session.connection().exec_driver_sql("SELECT count(*) FROM repeats").scalar() == 0


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
    again = accept(store)
    assert isinstance(again, KeptAnswer) is (moment == "committed") is (kept is not None)
    scan, *others = store.scans.page().items
    assert others == []
    assert len(store.jobs.page().items) == 1
    assert store.files.upload(store.jobs.page().items[0].kind, scan.id).read_bytes() == b"scan"
