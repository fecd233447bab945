"""A scanner's page: its chart, history, schedules and settings, as HTML."""

import itertools
import math
import re
from datetime import UTC, datetime, timedelta

import pytest
from asgi import absent
from results import SCANNER_FORM
from sqlalchemy import insert, select

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import KnownBaseline
from sawmill_contracts.measurements import MeasurementKind, Movement
from sawmill_contracts.scanner_drift import DriftFinding, PooledDrift
from sawmill_contracts.scans import ScanSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_service.pages.charts import DRIFT, MOST_MARKS, Span, days_of, drift_chart, range_of, thinned
from sawmill_store.mill_tables import ActivationRow, DriftChartRow, MeasurementRow, ScheduleRow, ScheduleRunRow
from sawmill_vocabulary import DataKind

NOW = datetime(2026, 11, 22, 12, 0, tzinfo=UTC)
LOOKS = {"checks": 50, "outliers": 0, "first_at": NOW - timedelta(days=9), "last_at": NOW - timedelta(days=9)}
OFFSETS = {"cor_column_offset_mm": 0.1, "tilt_offset_rad": 0.0, "covariance": [[1e-4, 0.0], [0.0, 1e-8]]}
BASELINE = KnownBaseline(method="view-pairs", **LOOKS, **OFFSETS)
POOLED = {"pooled_checks": 50, "pooled_cor_column_mm": -209.0}
TILT = {"tilt_change_deg": 0.0, "tilt_standard_deviation_deg": 0.01}


def movement(days_ago: float, moved_mm: float | None = 0.1, **changes) -> Movement:
    of = {"scanner_id": "example", "kind": MeasurementKind.DRIFT, "subject_id": "one", "against_id": "example"}
    seen = {"cor_column_mm": -147.0, "cor_column_change_mm": 0.1, "tilt_deg": -4.2, "tilt_change_deg": 0.01}
    moved = {"ray_change_mm": moved_mm, "within_tolerance": None if moved_mm is None else moved_mm <= 0.5}
    known = {"at": NOW - timedelta(days=days_ago), "ray_change_tolerance_mm": 0.5}
    return Movement(**of | seen | moved | known | changes)


def test_many_measurements_are_thinned_and_keep_their_extremes_and_an_absurd_value_has_a_range():
    two_years = [movement(730 - day, 0.1 + 0.0001 * (day % 7)) for day in range(1, 730)]
    two_years[300] = two_years[300]._replace(ray_change_mm=3.0, within_tolerance=False)
    two_years[400] = two_years[400]._replace(cor_column_mm=-140.0)
    two_years[500] = two_years[500]._replace(tilt_deg=-5.0)
    shown = thinned(two_years, Span.until(NOW, 730), [each.value for each in DRIFT.values()])
    assert len(shown) <= MOST_MARKS
    assert [one.at for one in shown] == sorted(one.at for one in shown)
    for one in (two_years[0], two_years[300], two_years[400], two_years[500], two_years[-1]):
        assert one in shown
    low, high = range_of([1e300], least=0.01)
    assert low < 1e300 < high
    assert range_of([5.0], least=0.01) == pytest.approx((4.999, 5.001))


def test_logs_together_are_a_line_with_its_band_behind_which_single_ones_are_faint():
    seen = [movement(20, None, kind=MeasurementKind.CALIBRATION)._replace(cor_column_mm=-209.1)]
    for day in (9, 8, 7):
        pooled = {"pooled_cor_column_mm": -209.0, "pooled_cor_column_standard_deviation_mm": 0.02}
        single = movement(day, 0.1)._replace(**pooled, against_id="second", method="view-pairs")
        seen.append(single._replace(cor_column_mm=-209.8 + 0.1 * day))
    times = {"began_at": NOW - timedelta(days=8)}
    times["began_between"] = (NOW - timedelta(days=8.5), NOW - timedelta(days=7.5))
    moved = {"cor_column_change_mm": 0.1, "cor_column_standard_deviation_mm": 0.01}
    finding = DriftFinding(kind="jump", evidence=60.0, limit=40.0, scatter=1.0, **times, **moved, **TILT)
    of = {"method": "view-pairs", "calibration_id": "second", "since": NOW - timedelta(days=10), "last_at": NOW}
    baseline = {"baseline": BASELINE, "baseline_cor_column_mm": -209.05, "baseline_tilt_deg": None}
    tilt = {"pooled_tilt_deg": -4.7, "pooled_tilt_standard_deviation_deg": 0.01}
    spread = {"pooled_cor_column_standard_deviation_mm": 0.02}
    together = PooledDrift(checks=60, finding=finding, alarm=finding, **of, **baseline, **POOLED, **spread, **tilt)
    span = Span.until(NOW, 30)
    chart = drift_chart(seen, [], span=span, tolerance_mm=0.5, total=len(seen), together=[together])
    rays, cor, tilt = chart.panels
    assert [mark.faint for mark in cor.marks] == [False, True, True, True]
    assert not any(mark.faint for panel in (rays, tilt) for mark in panel.marks)
    assert (rays.pooled, tilt.pooled, tilt.zeros) == ([], [], [])
    ((line, band),) = cor.pooled
    places = [tuple(map(float, place.split(","))) for place in line.split()]
    around = [tuple(map(float, place.split(","))) for place in band.split()]
    assert ([x for x, _ in places], len(places), len(around)) == ([mark.x for mark in cor.marks[1:]], 3, 6)
    assert min(y for _, y in around) < places[0][1] < max(y for _, y in around)
    ((began, zero),) = cor.zeros
    assert (began, zero > places[0][1]) == (span.x(BASELINE.first_at), True), "a smaller value stands lower"
    ((at, start, width),) = chart.changed
    assert start < at < start + width


def test_a_chart_has_hours_and_days_the_tolerance_and_marks_what_is_beyond_it():
    for days, step in ((0.5, timedelta(hours=3)), (1, timedelta(hours=6)), (7, timedelta(days=2))):
        ticks = [at for _, at in days_of(Span.until(NOW, days))]
        assert {later - earlier for earlier, later in itertools.pairwise(ticks)} == {step}
        assert all((at - at.replace(hour=0)) % min(step, timedelta(days=1)) == timedelta(0) for at in ticks)
        assert 3 <= len(ticks) <= 6
    seen = [movement(20, None, kind=MeasurementKind.CALIBRATION), movement(10, 0.25), movement(1, 9.0)]
    chart = drift_chart(
        seen, [("example", NOW - timedelta(days=20))], span=Span.until(NOW, 30), tolerance_mm=0.5, total=len(seen)
    )
    rays, cor, _ = chart.panels
    assert [(mark.tone, mark.beyond) for mark in rays.marks] == [("good", False), ("bad", True)]
    assert ([mark.shape for mark in cor.marks], cor.marks[0].tone) == (["calibration", "drift", "drift"], "idle")
    assert rays.marks[0].y > rays.tolerance_y > rays.marks[1].y
    assert [identifier for _, identifier, _ in chart.accepted] == ["example"]
    assert 2 <= len(chart.days) <= 6


def test_the_page_shows_how_a_scanner_stands_and_the_drawing_is_the_active_calibration_s(seeded, store):
    page = seeded.get("/scanners/example")
    assert page.status_code == 200
    for text in ("Fine", "The rays have moved 0.010", "Are the rays right?", "log-before.png", "drift check"):
        assert text in page.text
    rows = re.findall(r'<tr data-x="[^"]+">.*?</tr>', page.text)
    assert len(rows) == 2
    assert "not known" in rows[0]
    assert "0.010" in rows[1]
    assert seeded.get("/scanners/nobody").status_code == 404
    page = seeded.get("/scanners/example-spare").text
    for text in ("New", "It has no scan yet", "None was accepted yet"):
        assert text in page
    assert "Nothing was measured in this time" in page
    assert "The settings were changed since" not in seeded.get("/scanners/example").text
    seeded.post("/scanners/example/settings", data={**SCANNER_FORM, "source_to_cor_mm": "700"})
    page = seeded.get("/scanners/example").text
    drawn = re.search(r'<svg class="scanner".*?</svg>', page, re.DOTALL)[0]
    assert "859\N{NO-BREAK SPACE}mm" in drawn
    assert "700" not in drawn
    assert "the active calibration was made with 859.460\N{NO-BREAK SPACE}mm from source to turning axis" in page
    chart_of_example(store, DriftFinding(kind="quiet", evidence=3.0, limit=30.0, scatter=1.0))
    assert "The logs since the active calibration show no movement." in seeded.get("/scanners/example").text
    history = seeded.get("/scanners/example/history?days=0.5").text
    assert '<a class="button" href="?days=0.5#measured" aria-current="true">12 hours</a>' in history
    assert '<input type="hidden" name="days" value="0.5">' in history


def test_two_years_of_daily_measurements_are_a_small_page(seeded, store):
    now = datetime.now(UTC)
    known = {
        "scanner_id": "example",
        "within_tolerance": True,
        "source_to_detector_mm": 1600.0,
        "relative_residual": 0.01,
    }
    rows = [
        {**known, "at": now - timedelta(days=day), "kind": kind, "subject_id": f"{kind}-{day}"}
        | {"ray_change_mm": 0.1 + 0.05 * math.sin(day), "cor_column_mm": -147.0 + math.cos(day)}
        | {"tilt_rad": -0.07 + 0.02 * math.sin(2.0 * day)}
        for day in range(1, 730)
        for kind in MeasurementKind
    ]
    with store.database.write() as session:
        session.execute(insert(MeasurementRow), rows)
    page = seeded.get("/scanners/example?days=730")
    assert len(page.content) < 200_000  # of the 300 000 that a page may have with its styles and scripts
    assert page.text.count("<tr data-x=") <= MOST_MARKS
    assert "Of 1460 measurements the chart draws" in page.text


def chart_of_example(store, finding):
    found = finding.model_dump(mode="json")
    with store.database.write() as session:
        active = session.scalars(select(ActivationRow).where(ActivationRow.scanner_id == "example")).all()[-1]
        of = {"scanner_id": "example", "method": "view-pairs", "activation_number": active.number}
        known = {"kind": MeasurementKind.DRIFT, "against_id": active.calibration_id, "relative_residual": 0.01}
        known |= {"cor_column_mm": -209.0, "cor_column_change_mm": 0.1, "source_to_detector_mm": 1619.3}
        known |= {"tilt_rad": math.radians(-4.7), "tilt_change_rad": 0.0, "pooled_tilt_rad": math.radians(-4.7)}
        known["pooled_cor_column_standard_deviation_mm"] = 0.006
        known["pooled_tilt_standard_deviation_rad"] = math.radians(0.01)
        for hour in range(3):
            look = {"at": store.now() - timedelta(hours=hour, minutes=1), "subject_id": f"look-{hour}"}
            session.add(MeasurementRow(**of, **known, **POOLED, **look))
        alarm = {"at": store.now().isoformat(), "finding": found} if finding.began_at else None
        state = {"state": {}, "looks": 60, "changed_at": store.now(), "baseline": BASELINE.model_dump(mode="json")}
        session.add(DriftChartRow(finding=found, alarm=alarm, **of, **state))


@pytest.mark.parametrize(
    ("kind", "words", "finnish"),
    [
        ("jump", "it moved by +0.12 mm ± 0.02 mm on the detector", "se siirtyi +0,12 mm ± 0,02 mm ilmaisimella"),
        ("trend", "slowly, by +0.12 mm ± 0.02 mm a day", "hitaasti, +0,12 mm ± 0,02 mm vuorokaudessa"),
    ],
)
def test_a_scanner_that_moved_says_when_how_far_and_what_to_do(seeded, store, kind, words, finnish):
    began = store.now() - timedelta(hours=2)
    moved = {"cor_column_change_mm": 0.12, "cor_column_standard_deviation_mm": 0.01}
    times = {"began_at": began, "began_between": (began, began + timedelta(hours=1))}
    chart_of_example(store, DriftFinding(kind=kind, evidence=60.0, limit=30.0, scatter=1.0, **times, **moved, **TILT))
    store.alarms.check()
    page = seeded.get("/scanners/example?days=0.5").text
    state, chart = page[: page.index('id="newest"')], page[page.index('id="drift"') :]
    for part in (state, chart):
        text = " ".join(re.sub(r"<[^>]*>", "", part).split())
        assert absent(text, words, "Scan the phantom and calibrate.") == []
        assert f'<time datetime="{began:%Y-%m-%dT%H:%M:%S}' in part
    assert '<a class="button" href="?days=0.5#drift" aria-current="true">12 hours</a>' in page
    assert 'class="changed"' in chart
    translated = seeded.get("/scanners/example", headers={"Accept-Language": "fi"}).text
    assert finnish in " ".join(re.sub(r"<[^>]*>", "", translated).replace("\N{NO-BREAK SPACE}", " ").split())


def test_the_newest_is_accepted_and_an_older_one_rolled_back_with_a_reason(seeded, newer):
    assert f"/operator/activate/{newer}" in seeded.get("/scanners/example").text
    back = {"next": "/scanners/example", "reason": "the turntable <was> moved"}
    for identifier in (newer, "example"):
        done = seeded.post(f"/operator/activate/{identifier}", data=back)
        assert (done.status_code, done.headers["location"]) == (303, "/scanners/example")
    page = seeded.get("/scanners/example").text
    assert absent(page, "the turntable &lt;was&gt; moved", "somebody at this machine") == []
    assert seeded.post(f"/operator/activate/{newer}", data={"next": "//elsewhere.example/"}).headers["location"] == "/"


def test_a_schedule_is_made_of_plain_choices_or_of_cron_and_a_wrong_one_comes_back(seeded, store):
    path, zone = "/scanners/example-spare/schedules", "America/Vancouver"
    plain = {"days": "1-5", "clock": "05:30", "on_pass": "activate", "time_zone": zone}
    assert seeded.post(path, data=plain).status_code == 303
    assert seeded.post(path, data={"cron": "0 */6 * * *"}).status_code == 303
    page = seeded.get("/scanners/example-spare").text
    assert absent(page, "Monday to Friday at 05:30, America/Vancouver", "<code>0 */6 * * *</code>, UTC") == []
    drift = {"kind": "check-drift", "cron": "15 * * * *", "on_pass": "activate"}
    assert seeded.post(path, data=drift).status_code == 303
    assert "Check the newest log for drift</div>" in seeded.get("/scanners/example-spare").text.replace("\n", "")
    made = {each.cron: each for each in store.schedules.page(scanner_id="example-spare").items}
    assert "A calibration that passes is accepted, unless the scanner has moved." in page
    # At its own local time, not at that of this machine or of the browser.
    assert re.search(r">[^<>]*5:30[^<>]*</time> <span class=\"soft\">\(America/Vancouver\)</span>", page)
    assert (made["15 * * * *"].kind, made["15 * * * *"].on_pass) == ("check-drift", "report")
    gone = made["30 5 * * 1-5"].id
    # Another scanner's page does not delete it.
    assert seeded.post(f"/scanners/example/schedules/{gone}/delete").status_code == 404
    assert seeded.post(f"{path}/{gone}/delete").status_code == 303
    assert "Monday to Friday" not in re.findall(r"<b>.*?</b>", seeded.get("/scanners/example-spare").text)
    for typed, sentence in (
        ({"days": "1-5", "clock": "25:00", "time_zone": "Helsinki"}, "not “25:00”"),
        ({"days": "8", "clock": "05:00", "time_zone": "Helsinki"}, "Choose the days"),
        ({"cron": "every monday"}, "not &#39;every monday&#39;"),
        ({"days": "1-5", "clock": "05:30", "time_zone": "Helsinki"}, "as Europe/Helsinki or UTC, not “Helsinki”"),
    ):
        page = seeded.post("/scanners/example-spare/schedules", data=typed)
        assert page.status_code == 422
        assert sentence in page.text
        assert ("not “Helsinki”" in page.text) == (typed.get("time_zone") == "Helsinki")
        assert all(value in page.text for name, value in typed.items() if name != "days")


def test_a_schedule_s_times_and_outcomes_lead_where_they_can(seeded, store):
    made = store.schedules.create(ScheduleSpec(scanner_id="example-spare", cron="30 5 * * *"))
    with store.database.write() as session:
        session.get(ScheduleRow, made.id).time_zone = "Mars/Olympus"
    page = seeded.get("/scanners/example-spare").text
    assert "Every day at 05:30, Mars/Olympus" in page
    assert re.search(r">[^<>]*05:30[^<>]*</time> <span class=\"soft\">\(UTC\)</span>", page)
    running = store.calibrations.accept(CalibrationRequest(scan_id="example")).id
    with store.database.write() as session:
        for minute, calibration_id in enumerate(("example", running, None)):
            due_at = NOW.replace(minute=minute)
            session.add(
                ScheduleRunRow(schedule_id="example", due_at=due_at, outcome="queued", calibration_id=calibration_id)
            )
    page = seeded.get("/scanners/example").text
    schedules = page[page.index('id="schedules"') : page.index('id="settings"')]
    assert f'href="/calibrate?calibration={running}"' in schedules
    assert 'href="/calibrations/example/report?language=en"' in schedules
    assert "a calibration, which was removed since" in schedules


def test_a_new_scanner_is_added_its_settings_changed_and_decimals_have_a_comma_or_a_point(seeded, store):
    assert "A tape measure" in seeded.get("/scanners/new").text
    made = seeded.post("/scanners/new", data=SCANNER_FORM)
    assert made.status_code == 303
    path = made.headers["location"]
    identifier = path.rsplit("/", 1)[1]
    assert store.scanners.get(identifier).tolerances.ray_change_mm == 0.4
    sizes = {"log_radius_mm": "180", "row_pitch_mm": "2", "detector_arc_radius_mm": "1574"}
    changed = {**SCANNER_FORM, **sizes, "name": "Line 3", "object_turns": "between-passages"}
    assert seeded.post(f"{path}/settings", data=changed).status_code == 303
    scanner = store.scanners.get(identifier)
    assert (scanner.name, scanner.log_radius_mm, scanner.constants.row_pitch_mm) == ("Line 3", 180.0, 2.0)
    page = seeded.get(path).text.replace(",", "")
    assert absent(page, "on an arc of 1574", "one for each view</dd>", 'value="between-passages" selected>') == []
    assert "does not tell whether the scanner has moved" in page
    assert '"check-drift"' not in page
    assert '"check-drift"' in seeded.get("/scanners/example").text
    # Two editors: the second one sees what the first has saved, and nothing of hers is lost.
    tag = re.search(r'name="tag" value="([^"]+)"', seeded.get(path).text)[1].replace("&#34;", '"')
    first, second = ({**changed, "tag": tag, name: "181"} for name in ("log_radius_mm", "ray_change_mm"))
    assert seeded.post(f"{path}/settings", data=first).status_code == 303
    refused = seeded.post(f"{path}/settings", data=second)
    assert refused.status_code == 412
    assert re.findall("“([^”]+)” is stored now", refused.text) == ["181", "0.4"]
    assert 'value="181" inputmode="decimal" required autocomplete="off" aria-describedby="ray_change' in refused.text
    tag = re.search(r'name="tag" value="([^"]+)"', refused.text)[1].replace("&#34;", '"')
    assert seeded.post(f"{path}/settings", data=second | {"tag": tag}).status_code == 303
    wrong = {"name": "", "source_to_cor_mm": "86 cm", "log_radius_mm": "-150"}
    page = seeded.post("/scanners/new", data={**SCANNER_FORM, **wrong}).text
    assert re.findall(r'<input id="(\w+)"[^>]*aria-invalid', page) == list(wrong)
    assert "<details open>" in page  # the radius has a good default, and is folded otherwise
    for language in ("en", "fi"):
        for typed in ("859,46", "859.46"):
            form = {**SCANNER_FORM, "source_to_cor_mm": typed}
            made = seeded.post("/scanners/new", data=form, headers={"Accept-Language": language}).headers["location"]
            assert store.scanners.get(made.rsplit("/", 1)[1]).constants.source_to_cor_mm == 859.46


def test_an_imported_geometry_is_shown_as_not_checked_until_a_calibration_is_accepted(seeded, store, worker):
    def shown():
        row = re.search(r'id="scanner-example-spare".*?</li>', seeded.get("/").text, re.DOTALL)
        return row[0], seeded.get(path).text

    path, typed = "/scanners/example-spare", SCANNER_FORM | {"imported_theta": "146.1deg,714.7"}
    refused = seeded.post(f"{path}/settings", data=typed).text
    assert re.findall(r'<input id="(\w+)"[^>]*aria-invalid', refused) == ["imported_theta"]
    typed["imported_theta"] = "146.1deg,714.7,319.9,43.7,15.7deg"
    assert seeded.post(f"{path}/settings", data=typed).status_code == 303
    row, page = shown()
    for text in (row, page):
        assert absent(text, "Imported, not checked", "Its geometry is imported, not checked.") == []
    assert absent(page, f'value="{typed["imported_theta"]}"', "as the imported geometry has it", "<dd>714.7") == []
    spec = ScanSpec(scanner_id="example-spare", data=DataKind.COUNTS, phantom_id="l-shape")
    scan = store.scans.accept(spec, store.files.receive([b"x"], max_bytes=10))
    worker.finish_scan()
    log = seeded.post("/v1/reconstructions", json={"scan_id": scan.id}).json()
    check = seeded.post("/v1/drifts", json={"scan_id": scan.id}).json()
    assert log["options"]["theta"] == check["options"]["theta"]
    assert (check["calibration_id"], check["links"]["calibration"]) == (None, None)
    worker.finish_reconstruction()
    worker.finish_drift(within_tolerance=None)
    for text in shown():
        found = re.search("shows the turning axis (.*?) on the detector from the imported geometry", text)[1]
        assert re.sub(r"\s", " ", found) == "+0.10 mm (± 0.20 mm)"
    seeded.post("/v1/calibrations", json={"scan_id": scan.id, "activate": True})
    worker.finish_calibration()
    assert all("mported geometry." not in text and "not checked." not in text for text in shown())


def test_a_watched_folder_is_set_and_its_rules_stay(seeded, store, tmp_path):
    store.settings.watch_folders.append(tmp_path)
    given = {**SCANNER_FORM, "watched_folder": str(tmp_path / "line-2"), "watched_folder_data": "line-integrals"}
    assert seeded.post("/scanners/example/settings", data=given).status_code == 303
    scanner = store.scanners.get("example")
    watched = scanner.watched_folder
    assert (watched.folder, watched.data, watched.match) == (given["watched_folder"], "line-integrals", "*")
    by_program = watched.model_copy(update={"match": "*.h5", "still_for_s": None})
    store.scanners.update("example", scanner.model_copy(update={"watched_folder": by_program}))
    page = seeded.get("/scanners/example").text
    assert absent(page, f'value="{given["watched_folder"]}"', '<option value="line-integrals" selected>') == []
    seeded.post("/scanners/example/settings", data={**given, "watched_folder": str(tmp_path / "line-3")})
    watched = store.scanners.get("example").watched_folder
    assert (watched.folder, watched.match, watched.still_for_s) == (str(tmp_path / "line-3"), "*.h5", None)
    taken = seeded.post("/scanners/new", data={**given, "watched_folder": str(tmp_path / "line-3/a")})
    assert (taken.status_code, "watched folder of scanner &#39;example&#39;" in taken.text) == (422, True)
    seeded.post("/scanners/example/settings", data=SCANNER_FORM)
    assert store.scanners.get("example").watched_folder is None


def test_a_wrong_value_is_named_beside_its_field_and_nothing_typed_is_lost(seeded, store):
    for field, typed, sentence in (
        ("watched_folder", "/srv/elsewhere", "SAWMILL_WATCH_FOLDERS, which the administrator sets, allows no folder"),
        ("watched_folder", "line-2", "must be an absolute path without .., as /srv/scanners/line-2"),
        ("source_to_cor_mm", "-5", "must be more than 0, not -5"),
        ("source_to_cor_mm", "86 cm", "must be a number, as in 859.46, not “86 cm”"),
        ("source_to_cor_mm", "1.859,46", "not “1.859,46”"),
        ("source_to_cor_mm", "0.5", "constants.source_to_cor_mm must be at least 1, not 0.5"),
        ("num_detector_pixels", "768.5", "not “768.5”"),
        ("num_detector_pixels", "4", "must be 8 or more, not 4"),
        ("detector_pitch_mm", "", "This is needed."),
        ("name", "", "This is needed."),
        ("log_radius_mm", "900", "log_radius_mm 900 must be less than constants.source_to_cor_mm 859.46"),
        ("scale_percent", "200", "must be 100 or less, not 200"),
    ):
        page = seeded.post(
            "/scanners/example/settings",
            data={**SCANNER_FORM, "watched_folder_data": "counts", "name": "Renamed", field: typed},
        )
        assert page.status_code == 422
        marked = re.search(rf'<input id="{field}".*?</div>', page.text, re.DOTALL)[0]
        assert absent(marked, sentence, f'value="{typed}"', 'aria-invalid="true"') == []
        assert field == "name" or 'value="Renamed"' in page.text
        assert store.scanners.get("example").name == "Line <2>"
