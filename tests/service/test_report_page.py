"""`/calibrations/{id}/report`: the same page as `sawmill report`, with what the store knows beside the answer."""

import re

import pytest
from page_text import absent

from sawmill_contracts import kinds
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.contracts.keys import KeyAsk, Scope


@pytest.fixture
def report(seeded):
    def get(calibration_id="example"):
        return seeded.get(f"/calibrations/{calibration_id}/report")

    return get


def words(html: str) -> str:
    """What a person reads."""
    plain = re.sub(r"<style>.*?</style>|<[^>]+>", " ", html, flags=re.DOTALL)
    return " ".join(plain.split())


def test_the_report_names_scanner_scan_phantom_and_who_uses_it_and_stays_when_the_scan_is_deleted(report, store):
    answer = report()
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert answer.headers["cache-control"] == "no-store"
    text = words(answer.text)
    assert absent(text, "Calibration of Line &lt;2&gt;", "yes, the active one", "L-shape", "UTC") == []
    assert "movement 0.500 mm" in text
    assert answer.text.count("data:image/svg+xml;base64,") == 5  # phantom, log before and after, residual, search
    assert 'href="/scanners/example"' in answer.text
    store.scans.delete("example")
    answer = report()
    assert "Scan example " in words(answer.text)


def test_times_are_in_the_time_zone_of_the_mill(store, report):
    spec = ScheduleSpec(scanner_id="example", cron="30 5 * * 1-6", time_zone="Asia/Tokyo")
    store.schedules.create(spec, schedule_id="in-tokyo")
    assert "JST (UTC+09:00)" in words(report().text)


def test_a_newer_calibration_is_not_in_use_and_was_asked_for_by_a_key(seeded, store, worker, report):
    made = store.keys.create(KeyAsk(name="scanner of line 2", scope=Scope.SUBMIT))
    asked = seeded.request(
        "POST", "/v1/calibrations", json={"scan_id": "example"}, headers={"Authorization": f"Bearer {made.secret}"}
    )
    worker.finish_calibration(verdict="watch", rays_verdict="watch", reasons=["the <log> moved"])
    text = words(report(asked.json()["id"]).text)
    assert absent(text, "scanner of line 2", "In use no", "the &lt;log&gt; moved") == []


def test_without_its_file_the_report_has_no_pictures_and_says_so(report, store):
    store.files.result(kinds.CALIBRATE, "example", "result.h5").unlink()
    answer = report()
    assert "data:image" not in answer.text
    assert "No pictures" in answer.text


def test_a_calibration_without_an_answer_has_no_report(seeded, report):
    waiting = seeded.post("/v1/calibrations", json={"scan_id": "example"}).json()["id"]
    answer = report(waiting)
    assert answer.status_code == 409
    assert answer.json()["detail"] == f"calibration '{waiting}' is queued and has no report"
    assert report("nothing").status_code == 404
