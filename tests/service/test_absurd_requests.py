"""Requests whose values are each possible, and not together."""

import pytest

from sawmill_contracts.reconstructions import DECLARATION as RECONSTRUCTION
from sawmill_contracts.reconstructions import ReconstructionAsked


@pytest.mark.parametrize(
    ("path", "asked", "code", "sentence"),
    [
        ("calibrations", {"rows": "2:5"}, "rows-outside", "rows is 2:5, but scan 'example' has rows 0:4 only"),
        ("calibrations", {"log_rows": "0:9"}, "rows-outside", "log_rows is 0:9, but scan 'example' has rows 0:4 only"),
        ("calibrations", {"views": 13}, "views-too-many", "views is 13, but scan 'example' has 12"),
        ("reconstructions", {"rows": "0:100:9"}, "rows-outside", "rows is 0:100:9, but"),
        ("drifts", {"rows": "4:5"}, "rows-outside", "rows is 4:5, but"),
    ],
)
def test_what_a_scan_that_has_been_read_lacks_is_refused_at_once(seeded, store, path, asked, code, sentence):
    before = len(store.jobs.page(limit=200).items)
    answer = seeded.post(f"/v1/{path}", json={"scan_id": "example", **asked})
    assert (answer.status_code, answer.json()["code"]) == (422, code)
    assert answer.json()["detail"].startswith(sentence)
    assert len(store.jobs.page(limit=200).items) == before


def test_a_reconstruction_that_an_earlier_version_accepted_is_listed(seeded, store):
    """Its parameters are beyond what may be asked for now."""
    asked = {"scan_id": "example", "method": "tikhonov", "alpha": 1e-300}
    answer = seeded.post("/v1/reconstructions", json=asked)
    assert "body.alpha must be from 1e-09 to 1e+09, not 1e-300" in answer.json()["detail"]
    kept = store.asked(RECONSTRUCTION).accept(ReconstructionAsked(**asked))
    assert seeded.get(f"/v1/reconstructions/{kept.id}").json()["options"]["alpha"] == 1e-300


@pytest.mark.parametrize("moment", ["0001-01-01T00:00:00%2B14:00", "9999-12-31T23:59:59-14:00"])
@pytest.mark.parametrize(
    "path",
    ["/v1/scans?created_from=", "/v1/reconstructions?created_before=", "/v1/scanners/example/measurements?since="],
)
def test_a_moment_that_no_calendar_holds_in_utc_is_refused(seeded, path, moment):
    answer = seeded.get(path + moment)
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid-request")
    assert "beyond what calendars hold" in answer.json()["detail"]
