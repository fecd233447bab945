"""Open alarms over HTTP, on the pages and in metrics."""

from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import pytest
from page_text import absent
from results import SCANNER_FORM

from sawmill_contracts.scanners import AlarmLimits, ScannerSpec
from sawmill_service.scanner_conditions import SHOWN_SCANNERS, condition_of
from sawmill_store.store import Store


@pytest.fixture
def later(store):
    """What a scheduler finds three days later, of a scanner that may be silent for a day."""
    known = store.scanners.get("example")
    store.scanners.update("example", known.model_copy(update={"alarms": AlarmLimits(quiet_after_hours=24)}))
    other = Store(store.settings, clock=lambda: datetime.now(UTC) + timedelta(days=3))
    yield other
    other.close()


def test_an_alarm_is_listed_and_shown_until_it_ends(seeded, store, later):
    assert seeded.get("/v1/alarms").json() == {"alarms": []}
    ((_, opened),) = later.alarms.check()
    (alarm,) = seeded.get("/v1/alarms?scanner_id=example").json()["alarms"]
    assert (alarm["what"], alarm["scanner_id"], alarm["limit_hours"]) == ("scanner-quiet", "example", 24.0)
    assert datetime.fromisoformat(alarm["since"]) == opened.since
    assert seeded.get("/v1/alarms?scanner_id=example-spare").json() == {"alarms": []}
    sentence = "It has sent no scan for longer than is allowed."
    assert sentence in seeded.get("/scanners/example").text
    assert sentence in seeded.get("/").text
    finnish = seeded.get("/scanners/example", headers={"Accept-Language": "fi"}).text
    assert "Se ei ole lähettänyt skannauksia sallitussa ajassa" in finnish
    assert 'sawmill_scanner_alarm{scanner="example",what="scanner-quiet"} 1.0' in seeded.get("/metrics").text
    known = store.scanners.get("example")
    store.scanners.update("example", known.model_copy(update={"alarms": AlarmLimits()}))
    store.alarms.check()
    assert sentence not in seeded.get("/scanners/example").text
    assert 'sawmill_scanner_alarm{scanner="example",what="scanner-quiet"} 0.0' in seeded.get("/metrics").text


def test_an_acknowledged_alarm_is_shown_and_colours_nothing_until_its_time(seeded, store, later):
    later.alarms.check()
    path = "/v1/scanners/example/alarms/scanner-quiet/acknowledge"
    ask = {"until": "2026-01-01T00:00:00Z", "reason": "maintenance"}
    assert seeded.post(path, json=ask).json()["code"] == "acknowledgement-ended"
    assert 'data-changes-at="' not in seeded.get("/").text
    seeded.post("/operator/acknowledge/example/scanner-quiet", data={"reason": "Huolto", "zone": "Europe/Helsinki"})
    (alarm,) = seeded.get("/v1/alarms").json()["alarms"]
    assert alarm["acknowledged"]["reason"] == "Huolto"
    until = datetime.fromisoformat(alarm["acknowledged"]["until"])
    assert until.astimezone(ZoneInfo("Europe/Helsinki")).hour in {6, 14, 22}
    for page in ("/", "/scanners/example"):
        assert ": Huolto</strong>" in seeded.get(page).text
    assert (condition_of(store, store.scanners.get("example")).state.alarms) == ()
    assert f'data-changes-at="{until:%Y-%m-%dT%H:%M}' in seeded.get("/").text
    wrong = seeded.post("/operator/acknowledge/example/scanner-quiet", data={"until": "noon"})
    assert wrong.json()["detail"] == "until must be a time such as 14:00, not 'noon'"
    assert "Acknowledged" in seeded.get("/scanners/example/history?kind=alarm").text


def test_every_alarm_of_a_scanner_that_is_not_fine_is_on_the_first_page(seeded, store, later):
    limits = AlarmLimits(quiet_after_hours=24, phantom_scan_every_days=1)
    spare = store.scanners.get("example-spare")
    store.scanners.update("example-spare", spare.model_copy(update={"alarms": limits}))
    later.alarms.check()
    row = seeded.get("/").text.split('id="scanner-example-spare"')[1].split("</li>")[0]
    assert absent(row, "It has no scan yet", "It has sent no scan for longer than is allowed") == []
    assert "No phantom was scanned for longer than is allowed" in row
    assert "Counted from:" in seeded.get("/scanners/example-spare").text


def test_alarms_beyond_the_scanners_that_metrics_show_are_counted(seeded, store, later):
    later.alarms.check()
    spare = ScannerSpec.model_validate(store.scanners.get("example-spare").model_dump(include={"name", "constants"}))
    with store.database.write_as_one():
        for _ in range(SHOWN_SCANNERS):
            store.scanners.create(spare)
    scraped = seeded.get("/metrics").text
    assert 'sawmill_scanner_alarm{scanner="example",what="scanner-quiet"} 1.0' in scraped
    assert 'sawmill_scanner_calibration_failed{scanner="example"}' not in scraped


def test_limits_are_set_on_the_scanner_s_page(seeded, store):
    typed = SCANNER_FORM | {"phantom_scan_every_days": "14", "quiet_after_hours": ""}
    assert seeded.post("/scanners/example/settings", data=typed).status_code == 303
    assert store.scanners.get("example").alarms == AlarmLimits(phantom_scan_every_days=14)
    wrong = seeded.post("/scanners/example/settings", data={**typed, "quiet_after_hours": "0"})
    assert "must be more than 0, not 0" in wrong.text
