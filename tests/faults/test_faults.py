"""The fault study: a small part of it, and that its counts see what they are there for."""

from random import Random

import httpx
import pytest
from sqlalchemy import text
from tests.faults import trial, work
from tests.faults.audit import Audit, orphans
from tests.faults.planted import DEFECTS, ROOT
from tests.faults.trials import ENGINES, FAULTS, Plan, conduct_all
from tests.faults.work import Accepted, Asker, Work

from sawmill_contracts.plans import PlanRequest
from sawmill_contracts.scanners import ScannerSpec
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store

# Another one than the study's.
SEED = 12


@pytest.mark.nightly
@pytest.mark.timeout(400)
def test_jobs_under_kills_are_each_done_once_and_right(tmp_path):
    (kill,) = (fault for fault in FAULTS if fault.name == "kill")
    plan = Plan([kill], ENGINES[:1], jobs=4, seed=SEED, folder=tmp_path, mix=("plan", "drift check"), workers=1)
    (outcome,) = conduct_all(plan)
    counts = outcome.counts
    assert (counts.lost, counts.double, counts.unequal, counts.orphans) == (0, 0, 0, 0), counts.details
    assert counts.details == []
    assert counts.faults >= 1
    assert counts.jobs >= 7


@pytest.fixture
def store(tmp_path):
    opened = Store.open(StorageSettings(data_folder=tmp_path, database_url=None))
    yield opened
    opened.close()


@pytest.fixture
def audit(store):
    watching = Audit(store.settings.url)
    watching.install()
    yield watching
    watching.close()


class Answering:
    """What a trial is counted with, over a service that answers every plan with its state alone."""

    def __init__(self, store, audit):
        self.data = store.files.folder
        self.client = httpx.Client(transport=httpx.MockTransport(lambda _: httpx.Response(200, json={"state": "?"})))
        self.client.base_url = "http://service"
        self.trial = trial.Trial(self, audit, Asker(self.client, 1.0), Random(SEED), most=0)  # noqa: S311

    def counts(self, right="?"):
        answer = f'{{"answer": {{"state": "{right}"}}, "files": {{}}}}'
        return trial.count(self.trial, {"plan 0": answer}, started=0.0)


def test_what_is_lost_double_unequal_or_left_over_is_counted(store, audit):
    store.scanners.create(ScannerSpec(name="line", constants=vars(work.SCANNER)), scanner_id="line")
    asked = PlanRequest(scanner_id="line", theta=vars(work.THETA))
    plan = store.plans.accept(asked, given={"phantom_id": "l-shape"})
    answering = Answering(store, audit)
    answering.trial.asker.accepted.append(Accepted(Work("plan 0", "plans"), plan.id, plan.job_id))
    counts = answering.counts()
    assert (counts.lost, counts.double, counts.unequal, counts.orphans) == (1, 0, 0, 0)

    def become(state):
        with audit.reading() as connection, connection.begin():
            connection.execute(text("UPDATE jobs SET state = :state"), {"state": state})

    become("succeeded")
    assert answering.counts().sound
    assert answering.counts(right="another").unequal == 1
    become("running")
    become("succeeded")
    assert answering.counts().double == 1
    (answering.data / "plans" / "nobody-knows").mkdir()
    (answering.data / "attempts" / f"{plan.job_id}-1").mkdir()
    assert answering.counts().orphans == 2
    assert orphans(answering.data, frozenset({"nobody-knows"})) == [f"attempts/{plan.job_id}-1"]


def test_an_accepted_job_without_a_row_is_lost(store, audit):
    answering = Answering(store, audit)
    answering.trial.asker.accepted.append(Accepted(Work("plan 0", "plans"), "gone", "gone"))
    assert answering.counts().details == ["lost: job gone not in the database"]


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.file)
def test_a_planted_defect_has_one_place_and_its_tests(defect):
    assert defect.old != defect.new
    assert defect.place(ROOT).is_file()
    assert defect.test_files(ROOT)
