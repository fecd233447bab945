"""Today and its open alarms, on the pages, over HTTP and in metrics."""

import re
from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import pytest
from asgi import absent
from results import SCANNER_FORM, comparison
from sqlalchemy import event

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.scanners import AlarmLimits, ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_service.scanner_conditions import SHOWN_SCANNERS, condition_of
from sawmill_store.examples import SCANNER_NAMES
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind

FAILURE = Failure(kind=FailureKind.INPUT, code="phantom-not-seen", detail="no phantom in rows <0:4>")


def newest(seeded, worker, **changes):
    identifier = seeded.post("/v1/calibrations", json={"scan_id": "example"}).json()["id"]
    worker.finish_calibration(**changes)
    return identifier


def checked(seeded, worker, **changes):
    identifier = seeded.post("/v1/drifts", json={"scan_id": "example"}).json()["id"]
    worker.finish_drift(**changes)
    return identifier


def scanned(store, worker, **ask):
    spec = ScanSpec(scanner_id="example-spare", data=DataKind.COUNTS, phantom_id="l-shape")
    store.scans.accept(spec, store.files.receive([b"x"], max_bytes=10), scan_id="spare")
    worker.finish_scan()
    store.calibrations.accept(CalibrationRequest(scan_id="spare", **ask))


def rows(client) -> dict[str, str]:
    found = re.findall(
        r'<li class="scanner card (\w+)" id="scanner-([\w-]+)">(.*?)</li>', client.get("/").text, re.DOTALL
    )
    return {identifier: f"{tone} {html}" for tone, identifier, html in found}


def word(row: str) -> tuple[str, str]:
    tone, badge_tone, badge = re.search(r'^(\w+) .*?<span class="badge (\w+)">(.*?)</span>', row, re.DOTALL).groups()
    assert tone == badge_tone
    return tone, badge


def button(row: str) -> tuple[str, str]:
    return re.search(r'<a class="button[^"]*" href="([^"]+)"[^>]*>([\w ]+)</a>', row).groups()


def headline(client) -> str:
    return re.search(r'<h1 id="headline"[^>]*>(.*?)</h1>', client.get("/").text)[1]


def test_what_comes_next_is_what_the_sentence_says(seeded, worker, store):
    nearly = newest(seeded, worker, comparison=comparison(0.43))
    row = rows(seeded)["example"]
    assert "Accept its newest calibration." in row
    assert button(row) == (f"/calibrate?calibration={nearly}", "Review")
    store.calibrations.activate(nearly, "by hand")
    newest(seeded, worker, verdict="fail", reasons=["the residual is too large", "h_S is not resolved"])
    row = rows(seeded)["example"]
    assert '<p lang="en">the residual is too large</p>' in row
    assert button(row) == ("/calibrate?scanner=example", "Scan again")


def test_failed_is_neither_new_nor_never_calibrated(seeded, store, worker):
    scanned(store, worker)
    spare = rows(seeded)["example-spare"]
    assert word(spare) == ("idle", "Never calibrated")
    assert "Being calibrated now." in spare
    store.jobs.fail(worker.claim(), FAILURE)
    shown = rows(seeded)
    assert list(shown) == ["example-spare", "example"], "the worst first"
    assert word(shown["example-spare"]) == ("bad", "Calibration failed")
    assert "The scan of the phantom could not be calibrated." in shown["example-spare"]
    assert "Being calibrated" not in shown["example-spare"]


def test_a_discard_puts_away_one_result_and_says_so(seeded, worker):
    def step(of="scanners/example"):
        return seeded.get(f"/v1/{of}/next-step").json()

    def discard(identifier):
        seeded.post(f"/v1/calibrations/{identifier}/discard", json={"reason": "the scan was disturbed"})

    untouched = step()
    first = newest(seeded, worker, comparison=comparison(1.31))
    with_first = step()
    second = newest(seeded, worker, comparison=comparison(1.02))
    with_second = step()
    discard(newest(seeded, worker, verdict="fail", reasons=["the residual is too large"]))
    assert step() == with_second
    discard(second)
    assert (step(), with_first["tone"]) == (with_first, "bad")
    good = newest(seeded, worker, comparison=comparison())
    page = f"/calibrate?calibration={good}"
    assert (step()["tone"], step()["button"]) == ("bad", "accept")
    assert 'primary large">Accept<' in seeded.get(page).text
    assert f'href="/calibrate?calibration={first}">Look at the earlier result<' in seeded.get("/scanners/example").text
    assert ">Discard<" in seeded.get(f"/calibrate?calibration={first}").text
    assert step(f"calibrations/{second}")["headline"] == "This calibration was discarded."
    discard(first)
    assert (step()["tone"], step(f"calibrations/{good}")["word"]) == ("good", "Fine")
    assert 'primary large">Accept<' in seeded.get(page).text
    discard(good)
    assert step() == untouched
    for path in ("/", "/scanners/example"):
        assert "A calibration was discarded <time" in seeded.get(path).text
    checked(seeded, worker, ray_change_mm=0.8, within_tolerance=False, reason="the COR moved")
    drifted = step()
    discard(newest(seeded, worker, comparison=comparison()))
    assert step() == drifted


def test_the_headline_counts_who_needs_somebody(seeded, store, worker):
    assert headline(seeded) == "1 fine, 1 needs you"
    assert "<title>(1) Today · Sawmill calibration</title>" in seeded.get("/").text
    checked(seeded, worker, ray_change_mm=0.8, within_tolerance=False, reason="the COR moved")
    assert headline(seeded) == "0 fine, 2 need you, 1 of them red"
    store.scanners.delete("example-spare")
    checked(seeded, worker)
    assert headline(seeded) == "The scanner is fine"
    assert "<title>Today · Sawmill calibration</title>" in seeded.get("/").text


def test_without_a_scanner_the_page_leads_to_the_first_in_three_steps(client):
    assert headline(client) == "There is no scanner yet"
    steps = re.search(r'<ol class="card first">(.*?)</ol>', client.get("/").text, re.DOTALL)[1]
    assert re.findall(r'href="([^"]+)"', steps) == ["/scanners/new", "/phantoms", "/calibrate"]


def test_of_many_scanners_equal_states_are_one_tile_and_they_take_no_more_questions_than_few(seeded, store):
    spec = store.scanners.get("example")
    for number in range(6):
        store.scanners.create(ScannerSpec(name=f"Line {number}", constants=spec.constants))
    shown, grey, fine = seeded.get("/").text.split('<details class="folded"')
    assert [part.count('<li class="scanner') for part in (shown, grey, fine)] == [0, 7, 1]
    assert ("Without a calibration: 7" in grey, "Fine: 1" in fine) == (True, True)
    assert "1 fine, 7 need you" in shown

    def statements() -> int:
        asked = []
        listener = lambda *_: asked.append(None)  # noqa: E731
        event.listen(store.database.engine, "before_cursor_execute", listener)
        assert seeded.get("/today/rows").status_code == 200
        event.remove(store.database.engine, "before_cursor_execute", listener)
        return len(asked)

    statements()  # the first look at a new service asks for the time as well
    few = statements()
    spec = store.scanners.get("example")
    for _ in range(10):
        store.scanners.create(ScannerSpec(name="another", constants=spec.constants))
    assert statements() <= few + 1  # the time again, on a slow machine


def test_a_display_on_the_wall_leads_nowhere_and_the_part_that_changes_is_that_of_the_page(seeded):
    shown = seeded.get("/?kiosk").text
    assert "Line &lt;2&gt;" in shown
    assert not re.findall(r"<(?:a|button|select|input)\b", shown.partition("<main")[2])
    assert "<nav" not in shown
    part = re.search(r'<ol class="scanners".*</ol>', seeded.get("/today/rows").text, re.DOTALL)[0]
    ages = r">[^<]*</time>"
    assert re.sub(ages, "", part) in re.sub(ages, "", seeded.get("/").text)


@pytest.fixture
def examples(seeded, store):
    """The seeded scanners under the names that a new data folder gives them."""
    for identifier, name in SCANNER_NAMES.items():
        spec = ScannerSpec.model_validate(
            store.scanners.get(identifier).model_dump(include=ScannerSpec.model_fields.keys())
        )
        store.scanners.update(identifier, spec.model_copy(update={"name": name}))
    return seeded


def test_examples_are_marked_and_counted_nowhere(examples, store, seeded, worker):
    checked(seeded, worker, ray_change_mm=0.8, within_tolerance=False, reason="the COR moved")
    assert headline(examples) == "There is no scanner yet"
    assert all('<span class="ribbon">Example</span>' in row for row in rows(examples).values())
    mine = store.scanners.create(ScannerSpec(name="Line 1", constants=store.scanners.get("example").constants)).id
    assert list(rows(examples)) == [mine, "example", "example-spare"]
    assert "example scanner" not in examples.get("/?kiosk").text


def test_one_button_removes_the_examples_and_all_that_was_made_of_them(examples, store, worker):
    job = examples.post("/v1/calibrations", json={"scan_id": "example"}).json()["job_id"]
    assert examples.post("/examples/delete").status_code == 409
    worker.finish_calibration()
    assert (store.jobs.get(job).state, examples.post("/examples/delete").headers["Location"]) == ("succeeded", "/")
    assert rows(examples) == {}
    kinds = "scans calibrations reconstructions drifts plans inspections fixed-pairs schedules"
    for kind in kinds.split():
        assert examples.get(f"/v1/{kind}").json()["items"] == [], kind
    assert "example-spare" not in {each.id for each in store.phantoms.page().items}
    assert "Remove the examples" not in examples.get("/").text
    assert [each.action for each in store.audit.page(limit=2).items] == ["phantom-deleted", "scanner-deleted"]


def test_movement_is_a_bar_to_its_tolerance(seeded, worker):
    for moved_mm, tone, share in ((0.05, "good", "0.100"), (0.43, "watch", "0.860"), (0.8, "bad", "1.600")):
        checked(
            seeded, worker, ray_change_mm=moved_mm, within_tolerance=moved_mm < 0.5, reason="the COR moved <0.81 mm>"
        )
        row = rows(seeded)["example"]
        assert (word(row)[0], absent(row, f'<div class="moved {tone}">', f"--share: {share}")) == (tone, [])
        assert f"<strong>{moved_mm:.2f}\N{NO-BREAK SPACE}mm</strong> of 0.50\N{NO-BREAK SPACE}mm" in row
        assert re.search(r'<time datetime="20\d\d-[^"]+" data-show="age"', row)
        assert absent(row, '<svg class="spark"', "checks in 30 days") == []
        if tone == "bad":
            assert "A log shows that something has moved: 0.80 mm, and 0.50 mm is allowed." in row
            assert '<p lang="en">the COR moved &lt;0.81 mm&gt;</p>' in row
        assert button(row) == ("/calibrate?scanner=example", "Calibrate")


@pytest.mark.parametrize("fails", [True, False])
def test_what_a_check_saw_holds_until_another_one_sees(seeded, store, worker, fails):
    checked(seeded, worker, ray_change_mm=0.62, within_tolerance=False, reason="the COR moved")
    store.drifts.accept(DriftRequest(scan_id="example"))
    if fails:
        store.jobs.fail(worker.claim(), Failure(kind=FailureKind.INPUT, code="no-log", detail="no log in the scan"))
    else:
        worker.finish_drift(within_tolerance=None, reason="too round")
    row = rows(seeded)["example"]
    assert word(row) == ("bad", "Out of tolerance")
    assert "<strong>0.62" in row
    words, why = ("failed.", "no log in the scan") if fails else ("could not tell whether it has moved.", "too round")
    assert re.search(rf"A drift check <time [^>]*>[^<]*</time> {words}", row)
    assert re.search(rf'lang="en"[^>]*>{why}<', seeded.get("/scanners/example").text)
    checked(seeded, worker)
    assert word(rows(seeded)["example"]) == ("good", "Fine")
    assert "A drift check" not in rows(seeded)["example"]


def test_a_log_that_could_not_be_seen_says_nothing_of_movement(seeded, worker, store):
    store.calibrations.activate(newest(seeded, worker), "by hand")
    checked(seeded, worker, within_tolerance=None, reason="too round")
    row = rows(seeded)["example"]
    assert word(row) == ("good", "Fine")
    assert "Not checked since its calibration." in row


@pytest.fixture
def later(store):
    """What a scheduler finds three days later, of a scanner that may be silent for a day."""
    known = store.scanners.get("example")
    store.scanners.update("example", known.model_copy(update={"alarms": AlarmLimits(quiet_after_hours=24)}))
    other = Store(store.settings, clock=lambda: datetime.now(UTC) + timedelta(days=3))
    yield other
    other.close()


def test_an_alarm_is_listed_and_shown_until_it_ends(seeded, store, later):
    assert seeded.get("/v1/alarms").json() == {"items": [], "next": None}
    ((_, opened),) = later.alarms.check()
    (alarm,) = seeded.get("/v1/alarms?scanner_id=example").json()["items"]
    assert (alarm["kind"], alarm["scanner_id"], alarm["limit_hours"]) == ("scanner-quiet", "example", 24.0)
    assert datetime.fromisoformat(alarm["since"]) == opened.since
    assert seeded.get("/v1/alarms?scanner_id=example-spare").json() == {"items": [], "next": None}
    sentence = "It has sent no scan for longer than is allowed."
    assert sentence in seeded.get("/scanners/example").text
    assert sentence in seeded.get("/").text
    finnish = seeded.get("/scanners/example", headers={"Accept-Language": "fi"}).text
    assert "Se ei ole lähettänyt skannauksia sallitussa ajassa" in finnish
    assert 'sawmill_scanner_alarm{kind="scanner-quiet",scanner="example"} 1.0' in seeded.get("/metrics").text
    store.scanners.update("example", store.scanners.get("example").model_copy(update={"alarms": AlarmLimits()}))
    store.alarms.check()
    assert sentence not in seeded.get("/scanners/example").text
    assert 'sawmill_scanner_alarm{kind="scanner-quiet",scanner="example"} 0.0' in seeded.get("/metrics").text


def test_an_acknowledged_alarm_is_shown_and_colours_nothing_until_its_time(seeded, store, later):
    later.alarms.check()
    path = "/v1/scanners/example/alarms/scanner-quiet/acknowledge"
    ask = {"until": "2026-01-01T00:00:00Z", "reason": "maintenance"}
    assert seeded.post(path, json=ask).json()["code"] == "acknowledgement-ended"
    assert 'data-changes-at="' not in seeded.get("/").text
    seeded.post("/operator/acknowledge/example/scanner-quiet", data={"reason": "Huolto", "zone": "Europe/Helsinki"})
    (alarm,) = seeded.get("/v1/alarms").json()["items"]
    assert alarm["acknowledged"]["reason"] == "Huolto"
    until = datetime.fromisoformat(alarm["acknowledged"]["until"])
    assert until.astimezone(ZoneInfo("Europe/Helsinki")).hour in {6, 14, 22}
    for page in ("/", "/scanners/example"):
        assert ": Huolto</strong>" in seeded.get(page).text
    assert (condition_of(store, store.scanners.get("example")).state.alarms) == ()
    assert f'data-changes-at="{until:%Y-%m-%dT%H:%M}' in seeded.get("/").text
    wrong = seeded.post("/operator/acknowledge/example/scanner-quiet", data={"until": "noon"})
    assert wrong.json()["detail"] == "until must be a time such as 2026-03-16T14:00, not 'noon'"
    assert "Acknowledged" in seeded.get("/scanners/example/history?kind=alarm").text


def test_a_known_red_stays_red_and_asks_for_nothing_until_its_time_or_a_newer_red(seeded, store, worker):
    assert seeded.post("/operator/acknowledge/example").json()["code"] == "scanner-not-red"
    checked(seeded, worker, ray_change_mm=0.8, within_tolerance=False, reason="the COR moved")
    asked = {"until": "2026-01-01T00:00", "zone": "Europe/Helsinki", "reason": "Laakeri vaihdetaan"}
    assert seeded.post("/operator/acknowledge/example", data=asked).json()["code"] == "acknowledgement-ended"
    assert seeded.post("/operator/acknowledge/example", data=asked | {"until": "2099-01-01T00:00"}).status_code == 422
    until = (store.now() + timedelta(days=2)).astimezone(ZoneInfo("Europe/Helsinki"))
    seeded.post("/operator/acknowledge/example", data=asked | {"until": f"{until:%Y-%m-%dT%H:%M}"})
    assert headline(seeded) == "0 fine, 1 needs you, 1 red and known"
    for page in ("/", "/?kiosk", "/scanners/example"):
        html = seeded.get(page).text
        assert re.search(r"<strong>Known until .*, by .+: Laakeri vaihdetaan</strong>", html), page
        assert 'class="badge bad"' in html, page
    known = seeded.get("/v1/scanners/example/next-step").json()["known"]
    assert datetime.fromisoformat(known["until"]) == until.replace(second=0, microsecond=0)
    assert "Acknowledge the red" not in seeded.get("/scanners/example").text
    assert 'sawmill_scanner_red_known{scanner="example"} 1.0' in seeded.get("/metrics").text
    assert "Laakeri vaihdetaan" in seeded.get("/scanners/example/history?kind=alarm").text
    checked(seeded, worker, ray_change_mm=0.9, within_tolerance=False, reason="the COR moved on")
    assert seeded.get("/v1/scanners/example/next-step").json()["known"] is None
    assert headline(seeded) == "0 fine, 2 need you, 1 of them red"
    known = seeded.post("/v1/scanners/example/red/acknowledge", json={"reason": "ordered"}).json()
    assert len(known["results"]) == 1
    assert headline(seeded) == "0 fine, 1 needs you, 1 red and known"
    checked(seeded, worker, ray_change_mm=1.0, within_tolerance=False, reason="the COR moved again")
    assert "Acknowledge the red" in seeded.get("/scanners/example").text


def test_limits_are_set_on_the_scanner_s_page_and_every_alarm_of_one_is_on_the_first_page(seeded, store, later):
    limits = AlarmLimits(quiet_after_hours=24, phantom_scan_every_days=1)
    store.scanners.update("example-spare", store.scanners.get("example-spare").model_copy(update={"alarms": limits}))
    later.alarms.check()
    row = seeded.get("/").text.split('id="scanner-example-spare"')[1].split("</li>")[0]
    assert absent(row, "It has no scan yet", "It has sent no scan for longer than is allowed") == []
    assert "No phantom was scanned for longer than is allowed" in row
    assert "Counted from:" in seeded.get("/scanners/example-spare").text
    typed = SCANNER_FORM | {"phantom_scan_every_days": "14", "quiet_after_hours": ""}
    assert seeded.post("/scanners/example/settings", data=typed).status_code == 303
    assert store.scanners.get("example").alarms == AlarmLimits(phantom_scan_every_days=14)
    wrong = seeded.post("/scanners/example/settings", data={**typed, "quiet_after_hours": "0"})
    assert "must be more than 0, not 0" in wrong.text


def test_alarms_beyond_the_scanners_that_metrics_show_are_counted(seeded, store, later):
    later.alarms.check()
    spare = ScannerSpec.model_validate(store.scanners.get("example-spare").model_dump(include={"name", "constants"}))
    with store.database.write_as_one():
        for _ in range(SHOWN_SCANNERS):
            store.scanners.create(spare)
    scraped = seeded.get("/metrics").text
    assert 'sawmill_scanner_alarm{kind="scanner-quiet",scanner="example"} 1.0' in scraped
    assert 'sawmill_scanner_calibration_failed{scanner="example"}' not in scraped
