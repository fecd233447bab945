"""One clock: the time zone of the mill, which the first browser sets and an administrator changes."""

from datetime import UTC, datetime

from asgi import absent

from sawmill_platform.contracts.keys import Scope
from sawmill_store.mill_tables import CalibrationRow, ReconstructionRow

AT = datetime(2026, 1, 15, 21, 30, tzinfo=UTC)


def test_names_pages_and_the_report_write_times_in_the_mill_s_zone(seeded, store):
    with store.database.write() as session:
        for table in (CalibrationRow, ReconstructionRow):
            session.get(table, "example").created_at = AT
    for name in ("example", "example-spare"):
        store.schedules.delete(name)
    assert "data-sets-zone" in seeded.get("/").text
    seeded.post("/operator/time-zone", data={"time_zone": "Asia/Tokyo", "first": "yes"})
    seeded.post("/operator/time-zone", data={"time_zone": "Europe/Berlin", "first": "yes"})
    assert store.mill_zone.get() == "Asia/Tokyo"
    log = seeded.get("/logs/example").text
    assert absent(log, 'data-zone="Asia/Tokyo"', "log 1, 06:30</h1>", ">16 Jan 2026, 06:30</time>") == []
    assert "16.1.2026 6.30 (Asia/Tokyo)" in seeded.get("/calibrations/example/report?language=fi").text
    assert "data-sets-zone" not in seeded.get("/").text


def test_only_an_administrator_sets_another_zone_and_only_one_that_exists(seeded, store):
    seeded.post("/operator/time-zone", data={"time_zone": "Europe/Helsinki", "first": "yes"})
    assert seeded.post("/operator/time-zone", data={"time_zone": "Pori"}).json()["code"] == "invalid-zone"
    seeded.post("/operator/time-zone", data={"time_zone": "Europe/Stockholm"})
    assert "Names, reports and pages write times in Europe/Stockholm." in seeded.get("/system").text
    seeded.bring(Scope.ACTIVATE)
    assert seeded.post("/operator/time-zone", data={"time_zone": "Asia/Tokyo"}).status_code == 403
    assert store.mill_zone.get() == "Europe/Stockholm"
