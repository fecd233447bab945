"""Drift checks of a scanner together: each counts once, whoever looks, and opens at most one alarm."""

import math
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta

import numpy as np
import pytest
from sqlalchemy import select, update
from structlog.testing import capture_logs

from sawmill_calibration.drift_checks.baselines import follow
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.history import HistoryKind
from sawmill_contracts.measurements import MeasurementKind
from sawmill_contracts.scans import ScanSpec
from sawmill_mill.alarms import alarm_sentence
from sawmill_store.drift.drift_charts import DriftCharts, _counted
from sawmill_store.mill_tables import ActivationRow, DriftChartRow, MeasurementRow
from sawmill_vocabulary import DataKind

pytestmark = pytest.mark.clocked

COLUMN, TILT = -209.1, -0.083
DEVIATIONS = np.array([0.05, 0.002])
COVARIANCE = np.outer(DEVIATIONS, DEVIATIONS) * [[1.0, -0.6], [-0.6, 1.0]]


@pytest.fixture
def calibrated(store, ready_scan, finish, clock):
    def calibrate():
        clock.advance(minutes=1)
        asked = store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id, activate=True))
        finish(store)
        return asked.id

    return calibrate


@pytest.fixture
def log(store, scanner, clock, finish):
    """A log that came, a minute after the one before; its scan's id."""

    def scan():
        clock.advance(minutes=1)
        content = str(clock.now).encode()
        spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS)
        accepted = store.scans.accept(spec, store.files.receive([content], max_bytes=100))
        finish(store)
        return accepted.id

    return scan


def answer(change, sha256, **changes):
    """What a check answers that measured a change since the calibration: mm and radians."""
    measured = {"cor_column_mm": COLUMN + change[0], "tilt_rad": TILT + change[1], "source_to_detector_mm": 1619.3}
    of = {"cor_column_mm": change[0], "tilt_rad": change[1], "source_to_detector_mm": 0.0}
    deviation = {"cor_column_mm": DEVIATIONS[0], "tilt_rad": DEVIATIONS[1], "source_to_detector_mm": None}
    known = {"measured": measured, "change": of, "covariance": np.pad(COVARIANCE, (0, 1)).tolist()}
    known |= {"standard_deviation": deviation, "change_standard_deviation": deviation}
    return known | {"method": "view-pairs", "input_sha256": sha256} | changes


@pytest.fixture
def look(store, log, finish):
    """Check a log that shows a change, with errors as it says; the check's id."""
    random = np.random.default_rng(17)

    def check(change=(0.0, 0.0), *, scan_id=None, **changes):
        scan_id = scan_id or log()
        asked = store.drifts.accept(DriftRequest(scan_id=scan_id))
        measured = random.multivariate_normal(np.asarray(change), COVARIANCE)
        finish(store, **answer(measured, changes.pop("input_sha256", store.scans.get(scan_id).sha256), **changes))
        return asked.id

    return check


def charted(store, scanner, changes, since=None):
    """Enter checks of many logs, five minutes apart, which wait for their chart."""
    random = np.random.default_rng(18)
    with store.database.write() as session:
        active = session.scalars(select(ActivationRow).order_by(ActivationRow.number.desc()).limit(1)).one()
        start = since or active.activated_at
        same = {"scanner_id": scanner.id, "kind": MeasurementKind.DRIFT, "against_id": active.calibration_id}
        same |= {"method": "view-pairs", "activation_number": active.number, "awaits_chart": True}
        same |= {"source_to_detector_mm": 1619.3, "relative_residual": 0.01, "covariance": COVARIANCE.tolist()}
        same |= {"cor_column_standard_deviation_mm": DEVIATIONS[0], "tilt_standard_deviation_rad": DEVIATIONS[1]}
        for number, change in enumerate(changes):
            column, tilt = random.multivariate_normal(np.asarray(change), COVARIANCE)
            measured = {"cor_column_mm": COLUMN + column, "cor_column_change_mm": column}
            measured |= {"tilt_rad": TILT + tilt, "tilt_change_rad": tilt}
            known = {"at": start + (number + 1) * timedelta(minutes=5), "subject_id": f"check-{number}"}
            session.add(MeasurementRow(**same, **measured, **known, input_sha256=f"{number:064}"))


def rows(store):
    checks = select(MeasurementRow).where(MeasurementRow.kind == MeasurementKind.DRIFT).order_by(MeasurementRow.number)
    with store.database.read() as session:
        return list(session.scalars(checks))


def test_a_check_counts_once_for_its_scan_and_only_after_the_active_calibration(store, ready_scan, calibrated, look):
    first = calibrated()
    again = store.drifts.get(look()).scan_id
    look(scan_id=again)
    look(scan_id=ready_scan.id)
    look(scan_id=again, input_sha256="c" * 64, rotation="reversed")
    second = calibrated()
    look()
    counted = rows(store)
    assert [row.activation_number for row in counted] == [1, *[None] * 3, 2]
    assert [row.awaits_chart for row in counted] == [True, *[None] * 3, True]
    assert [row.against_id for row in counted] == [first] * 4 + [second]
    measured = store.measurements.page(counted[0].scanner_id).items[0]
    assert measured.cor_column_tilt_covariance_mm_deg == pytest.approx(math.degrees(COVARIANCE[0, 1]))
    assert (measured.method, measured.baseline_checks, measured.pooled_checks) == ("view-pairs", None, None)


def go_on(store, scanner, follow=follow):
    while store.drift_charts.follow(scanner.id, follow):
        pass


@pytest.fixture
def short_portions(store):
    store.drift_charts = DriftCharts(store.database, portion=20)


def test_a_portion_that_another_process_has_put_in_meanwhile_leaves_the_chart(store, scanner, calibrated):
    calibrated()
    charted(store, scanner, [(0.0, 0.0)] * 5)

    def meanwhile(*given):
        go_on(store, scanner)
        return follow(*given)

    assert store.drift_charts.follow(scanner.id, meanwhile)
    (chart,) = store.drift_charts.of_scanner(scanner.id).charts
    assert chart.checks == 5
    assert store.drift_charts.waiting() == []


@pytest.mark.dialect
@pytest.mark.usefixtures("short_portions")
def test_each_look_goes_into_its_chart_once_whoever_looks_and_after_a_kill(store, scanner, calibrated):
    calibrated()
    charted(store, scanner, [(0.0, 0.0)] * 75)
    portions = []

    def killed_after_two(*given):
        if len(portions) == 2:
            raise KeyboardInterrupt
        portions.append(given[-1])
        return follow(*given)

    with pytest.raises(KeyboardInterrupt):
        go_on(store, scanner, killed_after_two)
    assert store.drift_charts.of_scanner(scanner.id).charts[0].checks == 40
    with ThreadPoolExecutor(3) as several:
        list(several.map(lambda _: go_on(store, scanner), range(3)))
    assert store.drift_charts.waiting() == []
    (chart,) = store.drift_charts.of_scanner(scanner.id).charts
    assert (chart.checks, chart.baseline.checks, chart.pooled_checks, chart.finding.kind) == (75, 50, 50, "quiet")
    assert (chart.alarm, chart.method) == (None, "view-pairs")
    at_once = follow({}, "view-pairs", [], [_counted(row, chart.since) for row in rows(store)])
    assert chart.finding == at_once.finding
    newest = rows(store)[-1]
    assert newest.pooled_cor_column_mm == pytest.approx(at_once.pools[-1][0].cor_column_mm, abs=1e-9)
    assert abs(newest.pooled_cor_column_mm - COLUMN) < 4.0 * newest.pooled_cor_column_standard_deviation_mm < 0.04


@pytest.mark.dialect
@pytest.mark.usefixtures("short_portions")
def test_a_chart_that_cannot_be_read_is_begun_anew_in_portions_and_nobody_waits_for_it(store, scanner, calibrated):
    calibrated()
    charted(store, scanner, [(0.0, 0.0)] * 50 + [(0.12, 0.0)] * 20)
    go_on(store, scanner)
    (known,) = store.drift_charts.of_scanner(scanner.id).charts
    pools = [row.pooled_cor_column_mm for row in rows(store)]
    with store.database.write() as session:
        session.execute(update(DriftChartRow).values(state={"layout": 1}))
    charted(store, scanner, [(0.12, 0.0)])
    numbers = []

    def writing(state, method, before, looks):
        numbers.append((len(before), len(looks)))
        store.scanners.update(scanner.id, scanner)  # a request that writes: its lock is free
        assert store.drift_charts.of_scanner(scanner.id).charts[0].finding.kind == "jump"
        return follow(state, method, before, looks)

    go_on(store, scanner, writing)
    assert numbers[-4:] == [(0, 20), (20, 20), (40, 20), (50, 11)]
    (anew,) = store.drift_charts.of_scanner(scanner.id).charts
    assert (anew.checks, anew.finding, anew.alarm, anew.baseline) == (71, known.finding, known.alarm, known.baseline)
    assert [row.pooled_cor_column_mm for row in rows(store)][:-1] == pools


def test_a_look_that_comes_after_a_later_calibration_s_is_left_out(store, scanner, calibrated, clock):
    calibrated()
    charted(store, scanner, [(0.0, 0.0)] * 2)
    since = clock.now
    calibrated()
    charted(store, scanner, [(0.0, 0.0)] * 3)
    go_on(store, scanner)
    with store.database.write() as session:
        late = session.scalars(select(MeasurementRow).order_by(MeasurementRow.number).limit(1).offset(2)).one()
        late.activation_number, late.awaits_chart = 1, True
    go_on(store, scanner)
    (chart,) = store.drift_charts.of_scanner(scanner.id).charts
    assert (chart.checks, chart.since >= since, store.drift_charts.waiting()) == (3, True, [])


def test_a_jump_opens_one_alarm_which_the_next_calibration_closes(store, scanner, calibrated, clock):
    first = calibrated()
    charted(store, scanner, [(0.0, 0.0)] * 80 + [(0.12, 0.0)] * 30)
    clock.advance(days=1)
    go_on(store, scanner)
    (opened,) = store.alarms.check()
    assert (opened.type, opened.alarm.kind, opened.alarm.drift.kind) == ("alarm-opened", "drift", "jump")
    assert opened.alarm.drift.cor_column_change_mm == pytest.approx(0.12, abs=0.06)
    jump_at = store.drift_charts.of_scanner(scanner.id).charts[0].since + timedelta(minutes=400)
    assert abs(opened.alarm.drift.began_at - jump_at) < timedelta(hours=2)
    assert "scan the phantom and calibrate" in alarm_sentence(opened.alarm)
    assert store.alarms.check() == []
    assert [alarm.kind for alarm in store.alarms.open(scanner_id=scanner.id)] == ["drift"]
    (chart,) = store.drift_charts.of_scanner(scanner.id).charts
    assert (chart.calibration_id, chart.alarm) == (first, opened.alarm.drift)
    event = store.events.following(0)[-1]
    assert (event.type, event.detail["kind"], event.detail["drift"]["kind"]) == ("alarm-opened", "drift", "jump")
    assert store.history.page(scanner.id, kind=HistoryKind.ALARM).items[0].why == alarm_sentence(opened.alarm)
    store.calibrations.activate(first, "the button was pressed once more")
    assert (store.drift_charts.of_scanner(scanner.id).charts, store.alarms.check()) == ([chart], [])
    with store.database.write() as session:
        session.execute(update(DriftChartRow).values(alarm={"at": "yesterday"}))
    with capture_logs() as log:
        assert store.alarms.check() == []
    assert [(entry["event"], entry["scanner_id"]) for entry in log] == [("alarms-unreadable", scanner.id)]
    assert [alarm.kind for alarm in store.alarms.open()] == ["drift"]
    second = calibrated()
    assert store.drift_charts.of_scanner(scanner.id).charts == []
    (closed,) = store.alarms.check()
    assert (closed.type, closed.alarm.kind) == ("alarm-closed", "drift")
    charted(store, scanner, [(0.3, 0.0)] * 51)
    go_on(store, scanner)
    (chart,) = store.drift_charts.of_scanner(scanner.id).charts
    assert (chart.calibration_id, chart.checks, chart.alarm) == (second, 51, None)
    assert chart.baseline.cor_column_offset_mm == pytest.approx(0.3, abs=0.03)
    assert store.alarms.check() == []


def test_a_baseline_is_handed_to_later_checks_which_say_how_old_it_is(store, scanner, calibrated, log, clock, finish):
    active = calibrated()
    charted(store, scanner, [(0.0, 0.0)] * 50)
    go_on(store, scanner)
    clock.advance(days=2)
    asked = store.drifts.accept(DriftRequest(scan_id=log()))
    (baseline,) = store.jobs.handed_over(asked.job_id).baselines
    assert (baseline.method, baseline.checks) == ("view-pairs", 50)
    uncertain = {"cor_column_mm": 0.05, "tilt_rad": 0.002, "source_to_detector_mm": None}
    against = baseline.model_dump() | {
        "ray_offset_mm": 0.0,
        "change": {"cor_column_mm": 0.02, "tilt_rad": 0.001, "source_to_detector_mm": 0.0},
        "change_standard_deviation": uncertain,
        "significance": uncertain,
    }
    finish(store, **answer((0.02, 0.001), "a" * 64, reference="baseline", baseline=against))
    result = store.drifts.get(asked.id).result
    assert (result.reference, result.at) == ("baseline", clock.now)
    assert result.baseline.age_hours == pytest.approx((clock.now - baseline.last_at).total_seconds() / 3600.0)
    measured = store.measurements.page(asked.scanner_id).items[0]
    assert (measured.baseline_checks, measured.baseline_age_hours) == (50, result.baseline.age_hours)
    assert (measured.against_id, measured.cor_column_baseline_change_mm) == (active, 0.02)
    calibrated()
    assert store.jobs.handed_over(store.drifts.accept(DriftRequest(scan_id=log())).job_id).baselines == ()
