"""`/v1/fixed-pairs`: files of several inspections, which stay as long as the job needs them."""

from datetime import timedelta

from asgi import refusal

from sawmill_contracts import kinds, pair_logs
from sawmill_contracts.fixed_pairs import DECLARATION
from sawmill_contracts.inspections import FILE_KEPT
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_platform.files.named_folders import Leftovers
from sawmill_store.mill_files import NAMED_FOLDERS

BODY = DECLARATION.to_ask.example["body"]
FILES = BODY["inspection_ids"]


def test_files_that_cannot_be_are_refused(seeded):
    for changes, refused in (
        ({"inspection_ids": [*FILES, "example"]}, (422, "invalid-request")),
        ({"inspection_ids": [FILES[0], "nothing"]}, (404, "inspection-not-found")),
    ):
        assert refusal(seeded.post("/v1/fixed-pairs", json=BODY | changes)) == refused


def test_a_file_stays_while_a_job_needs_it_and_is_not_taken_after_its_day(seeded, store, worker):
    asked = seeded.post("/v1/fixed-pairs", json=BODY).json()
    given = store.jobs.handed_over(asked["job_id"])
    assert given.readable == tuple(store.files.upload(kinds.INSPECT, each) for each in FILES)
    assert refusal(seeded.delete(f"/v1/inspections/{FILES[0]}")) == (409, "inspection-in-use")
    later = store.database.now() + FILE_KEPT + timedelta(hours=1)
    store.database.now = lambda: later
    leftovers = Leftovers(store.database, store.files, NAMED_FOLDERS, grace_s=0.0)
    removed = {path.name for _ in range(3) for path in leftovers.remove_some()}
    assert removed >= {"example", "example-spare"}
    assert not removed & set(FILES)
    assert refusal(seeded.post("/v1/fixed-pairs", json=BODY)) == (409, "inspection-expired")
    worker.finish_fixed_pairs()
    assert seeded.get(asked["links"]["self"]).json()["state"] == "succeeded"
    assert FILES[0] in {path.name for _ in range(3) for path in leftovers.remove_some()}


def page(client, path, language="en"):
    answer = client.get(path, headers={"Accept-Language": language})
    assert answer.status_code == 200
    return answer.text


def test_a_calibration_that_passed_asks_for_no_passage_and_one_that_failed_says_why(seeded, worker, store):
    passed = seeded.post("/v1/fixed-pairs", json=BODY).json()["id"]
    assert 'id="follow"' in page(seeded, f"/fixed-pairs/{passed}")
    worker.finish_fixed_pairs(verdict="pass", reasons=[], coded_reasons=[], upper_95_mm=0.05)
    shown = page(seeded, f"/fixed-pairs/{passed}")
    assert "The places of the pairs are known well enough." in shown
    assert "next passage" not in shown
    failed = seeded.post("/v1/fixed-pairs", json=BODY).json()["id"]
    failure = Failure(kind=FailureKind.INPUT, code="broken-file", detail="pair 2: the file ends too early")
    store.jobs.fail(worker.claim(), failure, retries=0)
    assert "pair 2: the file ends too early" in page(seeded, f"/fixed-pairs/{failed}")
    newest = page(seeded, "/fixed-pairs")
    assert newest.index(failed) < newest.index(passed)
    assert "These are the places of last time." in newest
    assert "Aja kappale läpi uudelleen" in page(seeded, "/fixed-pairs/example-pairs", "fi")


LOG = pair_logs.DECLARATION.to_ask.example["body"]


def test_a_log_waits_for_its_calibration_and_is_refused_once_that_has_failed(seeded, worker, store):
    asked = seeded.post("/v1/fixed-pairs", json=BODY).json()
    of_it = LOG | {"fixed_pairs_id": asked["id"]}
    log = seeded.post("/v1/pair-logs", json=of_it).json()
    failure = Failure(kind=FailureKind.INPUT, code="broken-file", detail="pair 2: the file ends too early")
    claim = worker.claim()
    assert (claim.job.subject_id, store.jobs.get(log["job_id"]).state) == (asked["id"], "queued")
    store.jobs.fail(claim, failure, retries=0)
    assert refusal(seeded.post("/v1/pair-logs", json=of_it)) == (409, "fixed-pairs-without-result")
    assert 'id="follow"' in page(seeded, f"/pair-logs/{log['id']}")
    seen = {"state": "disagree", "moved_mm": [2.0, 0.1, 0.1], "within_mm": [0.2] * 3, "suspect": 1}
    worker.finish_pair_log(agreement=seen, marks=[], unplaced=0)
    shown = page(seeded, f"/pair-logs/{log['id']}")
    assert "Pair 1 has moved, by all signs." in shown
    assert "2.00\u00a0mm ± 0.20\u00a0mm" in shown
    assert "0 marks" in shown
