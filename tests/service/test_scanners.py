"""Scanners, their schedules and their history: over HTTP, as a file, and as a page with its charts."""

import csv
import io
import re
from datetime import UTC, datetime, timedelta

import pytest
from asgi import absent, refusal
from results import CONSTANTS
from results import SCANNER_SPEC as SPEC
from sqlalchemy import delete, event, insert

from sawmill_contracts import mill_events
from sawmill_contracts.alarms import Alarm, AlarmKind
from sawmill_contracts.history import HistoryEntry, HistoryKind, HistoryMark
from sawmill_contracts.measurements import Measurement, MeasurementKind, Movement
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_platform.contracts.webhooks import WebhookRequest
from sawmill_platform.database.tables import EventRow
from sawmill_service.pages.charts import MOST_MARKS, TREND_PX, Span, trend_chart
from sawmill_service.routes.scanners import COLUMNS, history_csv
from sawmill_store.mill_tables import ActivationRow, CalibrationRow, DriftRow, MeasurementRow, ReconstructionRow

BOUNDS = [
    *(("source_shift_mm", [-1e300, 500]), ("detector_to_cor_mm", [-500, 1000])),
    *(("detector_tilt", [-1, 1e6]), ("detector_shift_mm", [500, -500])),
]
TINY = [
    ("detector_pitch_mm", 1e-7, "at least 0.001, not 1e-07"),
    ("row_pitch_mm", 1e-9, "at least 0.001, not 1e-09"),
    ("source_to_cor_mm", 1e-300, "at least 1, not 1e-300"),
]


def test_a_watched_folder_that_is_not_allowed_is_a_problem(client, store, tmp_path):
    store.settings.watch_folders.append(tmp_path)
    watched = {"folder": str(tmp_path / "line-2"), "data": "counts", "exceptions": [{"match": "p*", "data": "counts"}]}
    made = client.post("/v1/scanners", json={**SPEC, "watched_folder": watched})
    assert made.json()["watched_folder"]["exceptions"][0]["match"] == "p*"
    for folder, code in {
        "/srv": "folder-refused",
        f"{tmp_path}/../a": "invalid-request",
        "a": "invalid-request",
    }.items():
        answer = client.post("/v1/scanners", json={**SPEC, "watched_folder": {**watched, "folder": folder}})
        assert refusal(answer) == (422, code)
    assert client.put("/v1/scanners/example", json={**SPEC, "watched_folder": watched}).status_code == 404
    assert client.put(made.headers["Location"], json=SPEC).json()["watched_folder"] is None


def test_measurements_are_listed_newest_first_and_the_page_shows_their_charts(seeded):
    assert refusal(seeded.delete("/v1/scanners/example")) == (409, "scanner-in-use")
    page = seeded.get("/v1/scanners/example/measurements").json()
    listed = [(one["kind"], one["subject_id"]) for one in page["items"]]
    assert listed == [("drift", "example"), ("calibration", "example")]
    later = seeded.get("/v1/scanners/example/measurements", params={"since": "2999-01-01T00:00:00Z"}).json()
    assert (later, seeded.get("/v1/scanners/nobody/measurements").status_code) == ({"items": [], "next": None}, 404)
    refused = seeded.get("/v1/scanners/example/measurements", params={"since": "yesterday"})
    assert (refused.status_code, "since" in refused.text) == (422, True)
    assert f'href="{PAGE}"' in seeded.get("/scanners/example").text
    page = seeded.get(PAGE).text
    assert page.count('<svg class="values"') == 5
    assert page.count('<path class="spread-of"') == 2, "the error bars that are known"
    for text in (
        "Calibration",
        "Passed",
        "Within tolerance",
        "u_c -209.100",
        "± 0.200",
        "A value lies within its ± with 95 %.",
        "gain 1.00000 per mm",
        "/calibrations/example/report",
    ):
        assert text in page
    assert f'href="{FILE}"' in page
    drifts = seeded.get(f"{PAGE}?kind=drift-check&first=2026-01-01&last=2026-12-31&zone=Europe/Helsinki&days=30").text
    assert ("Within tolerance" in drifts, "Passed" in drifts) == (True, False)
    assert "history.csv?kind=drift-check&amp;since=2026-01-01T00%3A00%3A00%2B02%3A00" in drifts
    assert "Nothing was measured" not in drifts
    assert "There is no entry here" in seeded.get(f"{PAGE}?last=2020-01-01").text
    answers = [
        seeded.get(f"{PAGE}?{wrong}").status_code for wrong in ("first=nonsense", "kind=x", "zone=Mars", "after=x")
    ]
    assert (answers, seeded.get("/scanners/nobody/history").status_code) == ([422] * 4, 404)


def test_a_scanner_lives_from_creation_to_deletion_where_it_can_be_built_and_lists_are_paged(client):
    for changes, sentence in (
        *(({"bounds": {name: bounds}}, f"body.bounds.{name}") for name, bounds in BOUNDS),
        *(
            ({"constants": CONSTANTS | {name: value}}, f"constants.{name} must be {words}")
            for name, value, words in TINY
        ),
        *(({"alarms": {"quiet_after_hours": limit}}, "alarms.quiet_after_hours") for limit in (0, -1, 1e6, "often")),
        *(
            ({"log_radius_mm": mm}, f"log_radius_mm {mm:g} must be less than constants.source_to_cor_mm 859.46")
            for mm in (859.46, 1e5)
        ),
    ):
        answer = client.post("/v1/scanners", json={**SPEC, **changes})
        assert refusal(answer) == (422, "invalid-request")
        assert sentence in answer.json()["detail"]
    created = client.post("/v1/scanners", json=SPEC)
    assert created.status_code == 201
    path = created.headers["Location"]
    assert client.get(path).json() == created.json()
    replaced = client.put(path, json={**SPEC, "name": "Line 3"})
    assert (replaced.json()["name"], replaced.json()["id"]) == ("Line 3", created.json()["id"])
    assert (client.delete(path).status_code, client.get(path).json()["code"]) == (204, "scanner-not-found")
    made = [client.post("/v1/scanners", json=SPEC).json()["id"] for _ in range(5)]
    seen, after = [], {}
    while after is not None:
        page = client.get("/v1/scanners", params={"limit": 2, **after}).json()
        seen += [scanner["id"] for scanner in page["items"]]
        after = {"after": page["next"]} if page["next"] else None
    assert (seen, client.get("/v1/scanners?after=nonsense").json()["code"]) == (made[::-1], "invalid-cursor")


SCHEDULE = {"scanner_id": "example", "cron": "30 5 * * 1-6"}


def test_a_schedule_lives_from_creation_to_deletion_with_a_right_cron_expression_and_time_zone(seeded):
    created = seeded.post("/v1/schedules", json=SCHEDULE)
    assert created.status_code == 201
    path = created.headers["Location"]
    assert seeded.get(path).json()["next_due_at"].endswith("05:30:00Z")
    assert seeded.put(path, json={**SCHEDULE, "time_zone": "Asia/Tokyo"}).json()["next_due_at"].endswith("20:30:00Z")
    assert seeded.put(path, json={**SCHEDULE, "enabled": False}).json()["next_due_at"] is None
    assert (seeded.get(f"{path}/runs").json(), seeded.delete(path).status_code) == ([], 204)
    assert seeded.get(path).status_code == 404
    assert {item["id"] for item in seeded.get("/v1/schedules").json()["items"]} == {"example", "example-spare"}
    checks = {**SCHEDULE, "kind": "check-drift", "drift_options": {"rows": "0:8"}}
    made = seeded.post("/v1/schedules", json=checks).json()
    assert (made["kind"], made["drift_options"]["rows"]) == ("check-drift", "0:8")
    assert seeded.get("/v1/schedules/example").json()["kind"] == "recalibrate"
    refused = seeded.post("/v1/schedules", json={**checks, "on_pass": "activate"})
    assert refused.status_code == 422
    assert "on_pass 'activate' belongs to kind 'recalibrate', not 'check-drift'" in refused.json()["detail"]
    for cron in ("30 5 * *", "99 5 * * *", "often", "0 0 30 2 *"):
        answer = seeded.post("/v1/schedules", json={**SCHEDULE, "cron": cron})
        assert (*refusal(answer), cron in answer.json()["detail"]) == (422, "invalid-cron", True)
    for zone in ("Helsinki", "europe/helsinki", "../../etc/passwd", "/etc/passwd", "localtime", "Factory", ""):
        answer = seeded.post("/v1/schedules", json={**SCHEDULE, "time_zone": zone})
        assert refusal(answer) == (422, "invalid-zone")
        assert f"as Europe/Helsinki or UTC, not {zone!r}" in answer.json()["detail"]
    passages = {**SPEC, "constants": {**SPEC["constants"], "object_turns": "between-passages"}}
    here = {"scanner_id": seeded.post("/v1/scanners", json=passages).json()["id"]}
    assert seeded.post("/v1/schedules", json=SCHEDULE | here).status_code == 201
    for answer in (
        seeded.post("/v1/schedules", json=checks | here),
        seeded.put("/v1/schedules/example", json=checks | here),
    ):
        assert refusal(answer) == (422, "turned-between-passages")


HISTORY, PAGE = "/v1/scanners/example/history", "/scanners/example/history"
PATH, FILE = f"{HISTORY}/entries", f"{HISTORY}.csv"
NOW = datetime(2026, 11, 22, 12, 0, tzinfo=UTC)
FORMULA = '=HYPERLINK("http://evil.example","5,0")'


def lines_of(text):
    return list(csv.DictReader(io.StringIO(text), strict=True))


@pytest.mark.usefixtures("_another_is_active")
def test_it_is_listed_newest_first_and_narrowed(seeded):
    key = seeded.bring(Scope.ACTIVATE, name="Maija")
    seeded.post("/v1/calibrations/example/activate", json={"reason": "checked"})
    items = seeded.get(PATH).json()["items"]
    assert [f"{each['kind']} {each['type']}" for each in items] == [
        *("activation calibration-rolled-back", "activation calibration-activated", "calibration succeeded"),
        *("schedule schedule-created", "schedule schedule-created", "drift-check succeeded"),
        *("activation calibration-activated", "calibration succeeded", "settings scanner-created"),
    ]
    newest = items[0]
    assert (newest["who"], newest["key_id"], newest["why"]) == ("Maija", key.id, "checked")
    assert (newest["link"], newest["measured"]) == ("/v1/calibrations/example", None)
    assert (seeded.get(newest["link"]).status_code, items[7]["measured"]["gain"]) == (200, 1.0)
    page = seeded.get(PATH, params={"limit": 4}).json()
    rest = seeded.get(PATH, params={"after": page["next"]}).json()
    assert (page["items"] + rest["items"], rest["next"]) == (items, None)
    assert seeded.get(PATH, params={"kind": "calibration"}).json()["items"] == [items[2], items[7]]
    assert seeded.get(PATH, params={"since": "2999-01-01T00:00:00Z"}).json()["items"] == []
    for wrong in ({"kind": "nonsense"}, {"since": "yesterday"}, {"after": "x"}, {"form": "csv"}):
        assert seeded.get(PATH, params=wrong).status_code == 422
    assert seeded.get("/v1/scanners/nobody/history/entries").json()["code"] == "scanner-not-found"


@pytest.mark.usefixtures("_another_is_active")
def test_the_file_has_every_entry_the_columns_of_the_contract_and_no_formula(seeded):
    seeded.bring(Scope.ADMIN, name="@SUM(1)")
    seeded.post("/v1/calibrations/example/activate", json={"reason": FORMULA})
    answer = seeded.get(FILE)
    assert answer.headers["Content-Type"] == "text/csv; charset=utf-8"
    assert answer.headers["Content-Disposition"] == 'attachment; filename="example-history.csv"'
    assert answer.text.count("\r\n") == answer.text.count("\n") == 10
    lines = lines_of(answer.text)
    items = seeded.get(PATH).json()["items"][::-1]
    assert [line["number"] for line in lines] == [str(item["number"]) for item in items]
    assert (lines[-1]["who"], lines[-1]["why"]) == ("'@SUM(1)", f"'{FORMULA}")
    calibration, drift = lines[1], lines[3]
    measured = items[1]["measured"]
    for name in ("cor_column_mm", "tilt_deg", "source_to_detector_mm", "relative_residual"):
        assert float(calibration[name]) == measured[name]
    assert calibration["cor_column_mm"].startswith("-209.1")
    assert (calibration["gain_per_mm"], calibration["verdict"]) == ("1.0", "pass")
    assert (drift["gain_per_mm"], drift["verdict"], drift["within_tolerance"]) == ("", "", "true")
    assert [line["kind"] for line in lines_of(seeded.get(FILE, params={"kind": "drift-check"}).text)] == ["drift-check"]
    assert seeded.get("/v1/scanners/nobody/history.csv").json()["code"] == "scanner-not-found"
    fields = {*HistoryEntry.model_fields, *Measurement.model_fields, "gain_per_mm"} - {"measured", "gain", "scanner_id"}
    assert (sorted(COLUMNS), COLUMNS[:4]) == (sorted(fields), ("number", "at", "kind", "type"))


def test_the_file_is_written_while_it_is_read_and_what_is_unknown_or_deleted_has_no_link(store, seeded):
    entries = store.history.page("example").items

    def batches():
        yield entries
        pytest.fail("nobody has asked for the second one yet")

    parts = history_csv(batches())
    assert next(parts).startswith("number,at,kind,")
    assert next(parts).count("\r\n") == len(entries)
    entry = store.history.page("example").items[0]
    with store.database.write() as session:
        later = {"at": entry.at, "topic": HistoryKind.SETTINGS, "type": event_kinds.CLOCK_STEPPED, "subject": "scanner"}
        session.add(EventRow(group_id="example", subject_id="example", **later))
    assert "clock-stepped" in seeded.get(PAGE).text
    with store.database.write() as session:
        for table in (ActivationRow, DriftRow, ReconstructionRow, CalibrationRow):
            session.execute(delete(table))
    page = seeded.get(f"{PAGE}?kind=calibration").text
    entries = page[page.index('id="entries"') :]
    assert absent(entries, "(deleted)", "u_c -209.100") == []
    assert "/report" not in entries


def movement(days_ago, **changes):
    known = dict.fromkeys(Movement._fields) | {"at": NOW - timedelta(days=days_ago), "subject_id": "one", "gain": 0.02}
    known |= {"kind": MeasurementKind.CALIBRATION, "cor_column_mm": -209.0, "cor_column_standard_deviation_mm": 0.1}
    known |= {"tilt_deg": -4.0, "source_to_detector_mm": 1600.0, "relative_residual": 0.01}
    return Movement(**known | changes)


def test_a_trend_has_error_bars_lines_and_open_alarms():
    checks = [movement(day, kind=MeasurementKind.DRIFT, gain=None, relative_residual=0.5) for day in (3, 2)]
    wide = movement(1, kind=MeasurementKind.DRIFT, cor_column_standard_deviation_mm=50.0)
    days = [NOW - timedelta(days=days_ago) for days_ago in (9, 4, 3)]
    of, quiet, no_scan = "example", AlarmKind.SCANNER_QUIET, AlarmKind.NO_PHANTOM_SCAN
    marks = [
        HistoryMark(days[0], HistoryKind.ALARM, mill_events.ALARM_CLOSED, of, quiet),
        HistoryMark(days[1], HistoryKind.ACTIVATION, mill_events.CALIBRATION_ACTIVATED, "one", None),
        HistoryMark(days[2], HistoryKind.ALARM, mill_events.ALARM_OPENED, of, no_scan),
    ]
    opened = [Alarm(scanner_id="example", kind=AlarmKind.NO_PHANTOM_SCAN, since=NOW - timedelta(days=3))]
    chart = trend_chart([movement(4), *checks, wide], marks, opened, Span.until(NOW, 10), 4)
    cor, tilt, sdd, residual, gain = chart.panels
    bars = [tuple(map(float, bar)) for bar in re.findall(r"M([\d.]+) ([\d.]+)V([\d.]+)", cor.bars)]
    assert len(bars) == 4
    assert all(0 < high < mark.y < low < TREND_PX for mark, (_, low, high) in zip(cor.marks, bars, strict=True))
    assert bars[-1][1] - bars[-1][2] < 2 * (bars[0][1] - bars[0][2]), "a long bar flattens no other"
    assert (tilt.bars, [len(panel.marks) for panel in (cor, tilt, sdd, residual, gain)]) == ("", [4, 4, 1, 1, 1])
    assert [(x, identifier) for x, identifier, _ in chart.accepted] == [(cor.marks[0].x, "one")]
    assert chart.alarms == [(1.0, pytest.approx(9.8)), (pytest.approx(69.6), pytest.approx(29.4))]


@pytest.mark.slow
def test_a_year_is_a_small_page_and_few_queries(seeded, store):
    now = datetime.now(UTC)
    known = {"scanner_id": "example", "within_tolerance": True, "relative_residual": 0.01}
    known |= {"cor_column_standard_deviation_mm": 0.05, "tilt_standard_deviation_rad": 0.001}
    calibration, drift = MeasurementKind.CALIBRATION, MeasurementKind.DRIFT
    measured = [
        {**known, "number": 1000 + number, "at": now - timedelta(hours=number + 1), "subject_id": f"one-{number}"}
        | {"kind": drift if number % 24 else calibration, "source_to_detector_mm": 1600.0 + number % 7}
        | {"cor_column_mm": -209.0 + 0.01 * (number % 17), "tilt_rad": -0.07 + 0.0002 * (number % 23)}
        for number in range(8700)
    ]
    kinds = {calibration: ("calibration", "calibration"), drift: ("drift-check", "drift")}
    entries = [
        {"group_id": "example", "at": one["at"], "topic": kinds[one["kind"]][0], "type": event_kinds.SUCCEEDED}
        | {"subject": kinds[one["kind"]][1], "subject_id": one["subject_id"]}
        for one in measured
    ]
    with store.database.write() as session:
        session.execute(insert(MeasurementRow), measured)
        session.execute(insert(EventRow), entries)
    page = seeded.get(f"{PAGE}?days=365")
    assert page.status_code == 200
    assert len(page.content) < 220_000  # of the 300 000 that a page may have with its styles and scripts
    assert page.text.count("<tr data-x=") <= MOST_MARKS
    asked = ({}, {"kind": HistoryKind.ALARM}, {"until": now - timedelta(days=100)})
    plans = [plan_of(store, **which) for which in asked]
    assert all("SEARCH events USING INDEX ix_events_history" in plan and "TEMP B-TREE" not in plan for plan in plans)


def plan_of(store, **which):
    statements, engine = [], store.database.engine

    def note(*sent):
        statement, parameters = sent[2:4]
        if statement.startswith("SELECT events"):
            statements.append((statement, parameters))

    event.listen(engine, "before_cursor_execute", note)
    store.history.page("example", **which)
    event.remove(engine, "before_cursor_execute", note)
    ((statement, parameters),) = statements
    with engine.connect() as connection:
        return "\n".join(row[-1] for row in connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", parameters))


def test_a_replacement_of_what_another_editor_has_changed_is_refused(seeded):
    """Of everything that can be replaced; the tag does not change with what no editor changes."""
    webhook = {"url": "https://alarms.mill.example/sawmill", "enabled": False}
    spec = seeded.get("/v1/scanners/example-spare").json()
    spec = {name: spec[name] for name in ScannerSpec.model_fields}
    schedule = seeded.get("/v1/schedules/example").json()
    schedule = {name: schedule[name] for name in ScheduleSpec.model_fields}
    for path, body, changes in (
        ("/v1/scanners/example-spare", spec, {"name": "another"}),
        ("/v1/schedules/example", schedule, {"enabled": False}),
        ("/v1/webhooks/example", webhook, {"description": "another"}),
        ("/v1/retention", {"drifts_days": 300}, {"drifts_days": 400}),
    ):
        read = seeded.get(path).headers["ETag"]
        first = seeded.put(path, json=body | changes, headers={"If-Match": read})
        assert (first.status_code, first.headers["ETag"]) == (200, seeded.get(path).headers["ETag"]), first.text
        assert first.headers["ETag"] != read
        assert refusal(seeded.put(path, json=body, headers={"If-Match": read})) == (412, "precondition-failed")
        assert seeded.get(path).headers["ETag"] == first.headers["ETag"], "nothing was replaced"
        for condition in ({"If-Match": f'"other", {first.headers["ETag"]}'}, {"If-Match": "*"}, {}):
            assert seeded.put(path, json=body | changes, headers=condition).status_code == 200
    tag = seeded.get("/v1/scanners/example").headers["ETag"]
    assert seeded.post("/v1/calibrations/example/activate").status_code == 200
    assert seeded.get("/v1/scanners/example").headers["ETag"] == tag


def test_a_list_has_short_items_with_the_fields_of_the_query_alone(seeded):
    whole = seeded.get("/v1/calibrations").json()
    short = seeded.get("/v1/calibrations", params={"fields": "id,state,verdict"}).json()
    assert short["items"] == [{name: item[name] for name in ("id", "state", "verdict")} for item in whole["items"]]
    assert (short["next"], len(short["items"])) == (whole["next"], len(whole["items"]))
    wrong = seeded.get("/v1/calibrations", params={"fields": "id,stat"})
    assert refusal(wrong) == (422, "invalid-request")
    assert "query.fields.stat is not a known field: 'state' is" in wrong.text


def test_keys_and_webhooks_are_lists_with_pages(seeded, store):
    for name in ("first", "second"):
        store.keys.create(KeyRequest(name=name, scope=Scope.READ))
        store.webhooks.create(WebhookRequest(url="https://alarms.mill.example/sawmill", description=name))
    for path, field in (("/v1/keys", "name"), ("/v1/webhooks", "description")):
        newest = seeded.get(path, params={"limit": 1, "fields": field}).json()
        assert newest["items"] == [{field: "second"}]
        older = seeded.get(path, params={"limit": 1, "fields": field, "after": newest["next"]}).json()
        assert older["items"] == [{field: "first"}]
