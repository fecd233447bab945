"""`/calibrate`, the report, two calibrations compared, and the next step, which all pages show alike."""

import json
import re
from dataclasses import replace
from html import unescape

import pytest
from asgi import absent, refusal
from results import FRAME, SCANNER_FORM, calibration_result, comparison

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.inspections import InspectionOptions
from sawmill_contracts.phantoms import PhantomPicture
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.scanners import ScannerRequest
from sawmill_contracts.scans import ScanSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_platform.workers.settings import Retries
from sawmill_service.app import create_app
from sawmill_store.store import Store
from sawmill_tomography.calibration.refusals import CalibrationError, refuse_unfound
from sawmill_tomography.phantoms.built_in import BUILT_IN
from sawmill_vocabulary import DataKind
from sawmill_vocabulary.calibration_messages import CalibrationMessage
from sawmill_vocabulary.geometry import Scanner
from sawmill_vocabulary.movement_messages import LogMessage, MovementMessage
from sawmill_vocabulary.reading_messages import PreparingMessage
from sawmill_vocabulary.scan_messages import EffectMessage

ANSWERS = {"scanner_id": "example", "phantom_id": "l-shape", "data": "counts", "angles_deg": "0:30"}
ANGLES = {"name": "angles", "flag": "--angles-deg", "field": "angles_deg", "why": "the file carries none"}
DATASET = {"name": "array", "flag": "--dataset", "field": "dataset", "why": "it holds two"}


@pytest.fixture
def inspect(store, worker):
    def inspected(name="morning <1>.npz", **changes):
        received = store.files.receive([b"a scan"], max_bytes=100)
        inspection = store.inspections.accept_file(InspectionOptions(), received, name=name)
        worker.finish_inspection(**changes)
        return inspection.id

    return inspected


def shown(page):
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]*>", " ", getattr(page, "text", page))))


def inputs(answer, name):
    return re.findall(rf'name="{name}" (?:required )?value="([^"]*)"', answer.text)


def test_without_a_file_it_takes_one(seeded):
    page = seeded.get("/calibrate?scanner=example")
    assert 'type="file"' in page.text
    assert "Waiting for the phantom's scan of Line <2>" in shown(page)
    assert 'data-max-bytes="100000"' in page.text


def test_without_a_scanner_it_leads_to_a_new_one_or_takes_the_file_first(client):
    assert absent(client.get("/calibrate").text, 'href="/scanners/new"', 'type="file"') == []


def test_only_what_the_file_does_not_say_is_asked(seeded, inspect):
    page = seeded.get(f"/calibrate?inspection={inspect()}")
    assert "morning <1>.npz" in shown(page)
    assert inputs(page, "scanner_id") == ["example-spare", "example"]
    assert "l-shape" in inputs(page, "phantom_id")
    # Flat fields stand beside the numbers, so they are counts; and the angles are not missing.
    assert inputs(page, "data") == ["counts"]
    assert "What are the numbers?" not in shown(page)
    assert 'name="angles_deg"' not in page.text
    reading = {"shape": {"views": 12, "rows": 4, "detector": 16}}
    page = seeded.get(f"/calibrate?inspection={inspect(reading=reading, missing=[ANGLES])}")
    assert "What are the numbers?" in shown(page)
    assert re.search(r'value="counts" required disabled', page.text)
    assert "A full turn in equal steps is 0:30." in shown(page)
    page = seeded.get(f"/calibrate?scanner=example&inspection={inspect()}")
    assert re.search(r'value="example" required checked', page.text)
    assert re.search(r'value="l-shape" required checked', page.text)


def test_a_scanner_that_is_made_for_a_file_is_filled_from_it_and_then_chosen(seeded, inspect):
    inspection = inspect(reading={"shape": {"views": 12, "rows": 4, "detector": 1024}, "detector_pitch_mm": 1.1})
    page = seeded.get(f"/calibrate?inspection={inspection}&phantom=example-spare&angles=0%3A30")
    assert "No scanner that is described here can have made this file." in shown(page)
    path = unescape(re.search(r'href="(/scanners/new[^"]*)">Another scanner', page.text)[1])
    form = seeded.get(path)
    assert (re.findall(r'value="(1024|1\.1)"', form.text), shown(form).count("from your file")) == (["1024", "1.1"], 2)
    typed = SCANNER_FORM | {"num_detector_pixels": "1024", "detector_pitch_mm": "1.1"}
    again = seeded.post(path, data=typed | {"source_to_cor_mm": ""})
    assert (again.status_code, shown(again).count("from your file")) == (422, 2)
    made = seeded.post(path, data=typed | {"source_to_cor_mm": "1000"})
    asked = seeded.get(made.headers["Location"])
    (scanner,) = re.findall(r'name="scanner_id" value="([^"]*)" required checked', asked.text)
    assert f"scanner={scanner}" in made.headers["Location"]
    assert re.search(r'value="example-spare" required checked', asked.text)


def test_scanners_that_do_not_fit_are_disabled_with_the_reason_and_never_chosen(seeded, store, inspect):
    spare = store.scanners.get("example")
    for name, cells, pitch in [("Line 10", 16, 1.1), ("Line 2", 16, 1.1), ("Line 1", 16, 2.5), ("Line 3", 32, 1.1)]:
        constants = replace(spare.constants, num_detector_pixels=cells, detector_pitch_mm=pitch)
        store.scanners.create(ScannerRequest(name=name, constants=constants))
    reading = {"shape": {"views": 12, "rows": 4, "detector": 16}, "detector_pitch_mm": 1.1}
    chosen = next(each.id for each in store.scanners.page().items if each.name == "Line 3")
    page = seeded.get(f"/calibrate?scanner={chosen}&inspection={inspect(reading=reading)}")
    listed = re.findall(r'name="scanner_id" [^>]*>\s*<span>([^<]*?) <span class="soft">([^<]*)', page.text)
    assert [name for name, _ in listed[:2]] == ["Line 2", "Line 10"]
    assert ("Line 3", "32 cells, the file has 16") in listed
    assert ("Line 1", "2.500 mm between cells, the file has 1.100 mm") in listed
    assert f'value="{chosen}" disabled' in page.text
    assert "This file is not from Line 3: 32 cells, the file has 16." in shown(page)


def test_which_of_several_arrays_is_asked_first_and_looked_at(seeded, store, inspect, woken):
    parts = [{"name": name, "kind": "array", "shape": (12, 4, 16), "type": "uint16"} for name in ("/a", "/b")]
    inspection = inspect(reading=None, missing=[DATASET], parts=parts)
    assert inputs(seeded.get(f"/calibrate?inspection={inspection}"), "dataset") == ["/a", "/b"]
    answer = seeded.post("/calibrate/dataset", data={"inspection_id": inspection, "dataset": "/b"})
    assert answer.status_code == 303
    again = store.inspections.get(answer.headers["Location"].partition("inspection=")[2])
    assert (again.options.dataset, again.options.name, woken) == ("/b", "morning <1>.npz", [again.job_id])


def test_answers_start_the_reading_and_the_calibration_of_many_views_with_an_angle_each(seeded, store, inspect, woken):
    inspection, other = inspect(), inspect()
    answer = seeded.post("/calibrate", data={**ANSWERS, "inspection_id": inspection})
    assert answer.status_code == 303
    path = answer.headers["Location"]
    calibration = store.calibrations.get(path.partition("calibration=")[2])
    scan = store.scans.get(calibration.scan_id)
    assert (scan.scanner_id, scan.phantom_id, scan.data, scan.angles_deg) == tuple(ANSWERS.values())
    assert (scan.name, store.files.upload(kinds.INGEST, scan.id).read_bytes()) == ("morning <1>.npz", b"a scan")
    assert woken == [scan.job_id, calibration.job_id]
    running = seeded.get(path)
    assert f'data-jobs="{scan.job_id} {calibration.job_id}"' in running.text
    assert f'data-cancel="{calibration.job_id}"' in running.text
    angles = ",".join(f"{0.25 * view:.4f}" for view in range(1440))
    answer = seeded.post("/calibrate", data={**ANSWERS, "angles_deg": angles, "inspection_id": other})
    calibration = store.calibrations.get(answer.headers["Location"].partition("calibration=")[2])
    assert store.scans.get(calibration.scan_id).angles_deg == angles
    answer = seeded.post("/scanners/example/settings", data={"name": "x" * 9000})
    assert refusal(answer) == (413, "body-too-large")
    assert answer.json()["detail"] == "the body may have at most 8192 bytes"


def test_a_wrong_answer_is_asked_again_with_the_others_kept(seeded, store, inspect, woken):
    for changed, sentence in (
        ({"phantom_id": ""}, "phantom_id is missing"),
        ({"data": "guess"}, "data should be 'counts'"),
        ({"scanner_id": "nowhere"}, "there is no scanner 'nowhere'"),
    ):
        inspection = inspect(missing=[ANGLES])
        before = len(store.scans.page().items)
        page = seeded.post("/calibrate", data={**ANSWERS, "inspection_id": inspection} | changed)
        assert page.status_code == 422
        assert sentence in shown(page)
        assert absent(page.text, 'value="0:30"', 'role="alert"') == []
        assert len(store.scans.page().items) == before
        assert woken == []


def test_a_refused_phantom_and_a_full_queue_leave_no_scan_behind_and_keep_the_answers(seeded, store, inspect, settings):
    picture = store.files.receive([b"no picture"], max_bytes=100)
    phantom = store.phantoms.accept_picture(PhantomPicture(name="blurred", width_mm=400.0), picture)
    failed(store, "picture", "nothing bright is in it")
    before = store.scans.page().items
    page = seeded.post("/calibrate", data={**ANSWERS, "inspection_id": inspect(), "phantom_id": phantom.id})
    assert page.status_code == 422
    assert "was refused and cannot be used" in shown(page)
    assert store.scans.page().items == before
    inspection, before = inspect(missing=[ANGLES]), store.scans.page().items
    again = Store(store.settings.model_copy(update={"max_queued_jobs": 1}))  # a place for one of the two
    seeded.app = create_app(settings, again, print)
    page = seeded.post("/calibrate", data={**ANSWERS, "inspection_id": inspection})
    assert page.status_code == 429
    assert "1 jobs wait, and 1 may in all" in shown(page)
    assert 'value="0:30"' in page.text
    assert again.scans.page().items == before
    again.close()


def test_answers_about_a_file_that_has_no_result_show_how_far_it_is(seeded, store):
    for path in ("/calibrate", "/calibrate/dataset"):
        received = store.files.receive([b"a scan"], max_bytes=100)
        inspection = store.inspections.accept_file(InspectionOptions(), received, name="a.npz")
        answers = {"inspection_id": inspection.id}
        assert f'data-jobs="{inspection.job_id}"' in seeded.get(f"/calibrate?inspection={inspection.id}").text
        assert f'data-jobs="{inspection.job_id}"' in seeded.post(path, data=answers).text
        failed(store, "unreadable", "its end is missing")
        assert "its end is missing" in shown(seeded.post(path, data=answers))


def test_a_file_that_is_no_scan_has_its_sentence(seeded, inspect):
    refusal = {"kind": "input", "code": "picture-file", "detail": "it is a picture and no scan"}
    page = seeded.get(f"/calibrate?inspection={inspect(verdict='refused', refusal=refusal, reading=None)}")
    assert "This is a picture, not a scan" in shown(page)
    refusal = {"kind": "input", "code": "calibration-file", "detail": "it is a calibration and no scan"}
    for name, leads in (("calibration-example.h5", True), ("calibration-none.h5", False), ("result.h5", False)):
        page = seeded.get(f"/calibrate?inspection={inspect(name, verdict='refused', refusal=refusal, reading=None)}")
        assert ("/calibrate?calibration=example" in page.text) is leads
    refusal = {"kind": "input", "code": "phantom-not-found", "detail": "as an earlier version called it"}
    page = seeded.get(f"/calibrate?inspection={inspect(verdict='refused', refusal=refusal, reading=None)}")
    assert "cannot be read as a scan" in shown(page)
    assert "Nothing has this id" not in shown(page)
    assert "Choose another file" in shown(page)


@pytest.fixture
def started(seeded, inspect):
    return seeded.post("/calibrate", data={**ANSWERS, "inspection_id": inspect(missing=[ANGLES])}).headers["Location"]


def failed(store, code, detail):
    claim = store.jobs.claim("test")
    store.jobs.fail(claim, Failure(kind=FailureKind.INPUT, code=code, detail=detail), retries=Retries())


def test_a_scan_that_cannot_be_read_is_tried_again_without_sending_it(seeded, store, started):
    failed(store, "angles-mismatch", "12 angles were given for 20 views")
    failed(store, "scan-refused", "the scan was refused")
    page = seeded.get(started)
    assert absent(shown(page), "12 angles were given for 20 views", "one angle for each view") == []
    again = unescape(re.search(r'href="([^"]*)">Try again with other answers', page.text)[1])
    assert "calibration=" not in again
    asked_again = seeded.get(again)
    assert re.search(r'value="l-shape" required checked', asked_again.text)
    assert 'name="angles_deg" required value="0:30"' in asked_again.text


def test_another_phantom_in_the_scan_is_named_first_with_a_button_that_calibrates_with_it(
    seeded, store, worker, started, woken
):
    worker.finish_scan(coded_remarks=[CodedReason.of(PreparingMessage.NO_SIGNAL(samples=50)).model_dump()])
    scanner = Scanner(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.5)
    with pytest.raises(CalibrationError) as refusal:
        refuse_unfound(scanner, BUILT_IN["l-shape"], None, 1.0, lambda: "rectangle-with-hole")
    failed(store, refusal.value.code, str(refusal.value))
    page = seeded.get(started)
    said = shown(page)
    hint = said.index("This looks like the phantom “Rectangle with hole”.")
    few = said.index("The scan has only 12 views. Scan a full turn with at least 120.")
    assert hint < few < said.index("too little light: 6.5 % of the measured") < said.index("Details")
    values = dict(re.findall(r'<input type="hidden" name="(scan_id|phantom_id)" value="([^"]*)">', page.text))
    calibration = store.calibrations.get(seeded.post("/calibrate", data=values).headers["Location"].rpartition("=")[2])
    assert (calibration.phantom_id, calibration.scan_id) == ("rectangle-with-hole", values["scan_id"])
    assert woken[-1] == calibration.job_id


def test_a_result_shows_what_it_is_worth_and_is_accepted_by_whoever_may(seeded, store, worker, started):
    worker.finish_scan()
    worker.finish_calibration(comparison=None)
    keys = {
        scope: store.keys.create(KeyRequest(name=scope, scope=scope)).secret for scope in (Scope.READ, Scope.SUBMIT)
    }
    asked = {scope: {"Authorization": f"Bearer {secret}"} for scope, secret in keys.items()}
    page = seeded.get(started, headers=asked[Scope.SUBMIT])
    assert "Accepting needs a key of the scope activate" in shown(page)
    assert "/operator/activate/" not in page.text
    assert 'type="file"' in seeded.get("/calibrate", headers=asked[Scope.SUBMIT]).text
    assert "Your key may only look" in shown(seeded.get("/calibrate", headers=asked[Scope.READ]))
    assert seeded.post("/calibrate", data=ANSWERS, headers=asked[Scope.READ]).status_code == 403
    page = seeded.get(started)
    assert absent(shown(page), "Are the rays right?", "Are the millimetres right?") == []
    assert "Accepting makes it the calibration that Line <2> uses from now on" in shown(page)
    action = re.search(r'action="(/operator/activate/[^"]*)"', page.text)[1]
    answer = seeded.post(action, data={"next": unescape(re.search(r'name="next" value="([^"]*)"', page.text)[1])})
    assert (answer.status_code, answer.headers["Location"]) == (303, started)
    assert store.scanners.get("example").active_calibration_id == action.rpartition("/")[2]
    assert "This is the active calibration" in shown(seeded.get(started))


def test_a_calibration_in_use_that_must_not_be_is_not_called_good(seeded, store, worker, started):
    worker.finish_scan()
    worker.finish_calibration(verdict="fail", rays_verdict="fail", reasons=["The residual is too large."])
    store.calibrations.activate(re.search(r"calibration=(\w+)", started)[1], "by hand")
    page = shown(seeded.get(started))
    assert absent(page, "This calibration is in use and must not be.", "Go back to an earlier one.") == []
    assert "Nothing needs to be done" not in page


def test_a_scan_that_is_here_already_is_asked_its_phantom_alone(seeded, store, woken):
    page = seeded.get("/calibrate?scan=example")
    assert re.search(r'value="l-shape" required checked', page.text)
    assert "Which scanner made it?" not in shown(page)
    answer = seeded.post("/calibrate", data={"scan_id": "example", "phantom_id": "example-spare"})
    calibration = store.calibrations.get(answer.headers["Location"].partition("calibration=")[2])
    assert (calibration.scan_id, calibration.phantom_id, woken) == ("example", "example-spare", [calibration.job_id])


def report(seeded, calibration_id="example"):
    return seeded.get(f"/calibrations/{calibration_id}/report")


def test_the_report_names_scanner_phantom_user_and_the_mill_s_times_and_stays_without_scan_and_file(seeded, store):
    answer = report(seeded)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert answer.headers["cache-control"] == "no-store"
    text = shown(answer)
    assert absent(text, "Calibration of Line <2>", "yes, the active one", "L-shape", "UTC", "movement 0.500 mm") == []
    assert answer.text.count("data:image/svg+xml;base64,") == 5  # phantom, log before and after, residual, search
    assert 'href="/scanners/example"' in answer.text
    store.scans.delete("example")
    spec = ScheduleSpec(scanner_id="example", cron="30 5 * * 1-6", time_zone="Asia/Tokyo")
    store.schedules.create(spec, schedule_id="in-tokyo")
    store.files.result(kinds.CALIBRATE, "example", "result.h5").unlink()
    answer = report(seeded)
    assert absent(shown(answer), "Scan example ", "(Asia/Tokyo)", "No pictures") == []
    assert "data:image" not in answer.text


def test_a_newer_calibration_s_report_says_who_asked_and_there_is_none_before(seeded, store, worker):
    made = store.keys.create(KeyRequest(name="scanner of line 2", scope=Scope.SUBMIT))
    headers = {"Authorization": f"Bearer {made.secret}"}
    asked = seeded.post("/v1/calibrations", json={"scan_id": "example"}, headers=headers).json()["id"]
    worker.finish_calibration(verdict="watch", rays_verdict="watch", reasons=["the <log> moved"])
    store.files.result(kinds.CALIBRATE, asked, "result.h5").unlink()  # its pictures take a second
    assert absent(shown(report(seeded, asked)), "scanner of line 2", "In use no", "the <log> moved") == []
    waiting = seeded.post("/v1/calibrations", json={"scan_id": "example"}).json()["id"]
    answer = report(seeded, waiting)
    assert answer.status_code == 409
    assert answer.json()["detail"] == f"calibration '{waiting}' is queued and has no report"
    assert report(seeded, "nothing").status_code == 404


PAGE = "/scanners/example/compare"


@pytest.fixture
def pair(store, worker) -> tuple[str, str]:
    """Two calibrations with error bars; the second has moved by 0.4 mm on the detector."""
    made = []
    for column_mm in (FRAME["cor_column_mm"], FRAME["cor_column_mm"] + 0.4):
        made.append(store.calibrations.accept(CalibrationRequest(scan_id="example")).id)
        spreads = calibration_result()["standard_deviation"]
        worker.finish_calibration(source_frame=FRAME | {"cor_column_mm": column_mm}, standard_deviation=spreads)
    return tuple(made)


def row(answer, name: str) -> str:
    return shown(re.search(rf"<tr><th scope=\"row\">{re.escape(name)}.*?</tr>", answer.text)[0]).strip()


def test_any_two_calibrations_are_compared_with_their_error_bars(seeded, pair):
    newest = seeded.get(PAGE)
    assert re.findall(r'<option value="(\w{6,})" selected', newest.text)[:2] == list(pair)
    moved = row(newest, "Centre of rotation on the detector (u_c)")
    # 1.96 times the root of 2 times 0.1 mm squared.
    assert moved.endswith("-209.100 mm -208.700 mm +0.400 mm 0.277 mm Has changed")
    assert row(newest, "Source to detector (SDD)").endswith("0.277 mm The same")
    other_way = seeded.get(f"{PAGE}?first={pair[1]}&second={pair[0]}")
    assert "-0.400 mm" in row(other_way, "Centre of rotation on the detector (u_c)")
    unknown = row(seeded.get(f"{PAGE}?first=example&second={pair[0]}"), "Centre of rotation on the detector (u_c)")
    assert unknown.endswith("not known Not certain")
    assert seeded.get(f"/scanners/example-spare/compare?first={pair[1]}&second={pair[0]}").status_code == 404


def test_before_the_second_calibration_there_is_nothing_to_compare(seeded):
    assert "There are no two calibrations to compare yet." in seeded.get(PAGE).text


def test_one_log_is_made_with_both_and_only_once(seeded, store, pair):
    fields = {"first": pair[0], "second": pair[1], "scan_id": "example-spare"}
    made = seeded.post(PAGE, data=fields)
    assert made.status_code == 303
    newest, older = (log.id for log in store.reconstructions.page(scan_id="example-spare").items)
    assert made.headers["Location"] == f"/logs/{newest}?beside={older}"
    assert {store.reconstructions.get(each).calibration_id for each in (newest, older)} == set(pair)
    assert seeded.post(PAGE, data=fields).headers["Location"] == made.headers["Location"]
    reading = ScanSpec(scanner_id="example-spare", data=DataKind.COUNTS)
    another = store.scans.accept(reading, store.files.receive([b"file"], max_bytes=100)).id
    for wrong in ({"first": ""}, {"second": "another one"}, {"scan_id": ""}, {"scan_id": "no such scan"}):
        assert seeded.post(PAGE, data=fields | wrong).status_code == 404, wrong
    assert seeded.post("/scanners/example-spare/compare", data=fields).status_code == 404, "another scanner's"
    refused = seeded.post(PAGE, data=fields | {"scan_id": another})
    assert refused.status_code == 409
    assert 'class="problem"' in refused.text


MOVED = MovementMessage.MOVED(MovementMessage.TURNTABLE(column_mm=2.61), moved_mm=0.66, allowed_mm=0.5)
SLIP = CalibrationMessage.EFFECT_FITTED(EffectMessage.SLIP(view=17, slip_mm=2.5, slip_deg=0.3), off_mm=0.26)
IMPRECISE = CalibrationMessage.IMPRECISE(rms_mm=0.05, upper_mm=0.19, allowed_mm=0.1)
DRIFTED = LogMessage.MOVED(LogMessage.DETECTOR_SLID(column_mm=-2.12), moved_mm=0.8, allowed_mm=0.5)


def reasons_of(*reasons):
    coded = [CodedReason.of(each) for each in reasons]
    return {"reasons": [each.sentence for each in coded], "coded_reasons": coded}


def compared(moved_mm, reason):
    return comparison(moved_mm, reason=str(reason), coded_reason=CodedReason.of(reason))


# The newest calibration, a drift check after it, and the button of the step.
STATES = {
    "good": ({"comparison": comparison()}, None, "accept"),
    "moved": ({"comparison": compared(0.66, MOVED), **reasons_of(MOVED)}, None, "scan-again"),
    "slipped": ({"comparison": comparison(), **reasons_of(SLIP)}, None, "scan-again"),
    "imprecise": ({"verdict": "watch", **reasons_of(IMPRECISE), "comparison": comparison()}, None, "scan-again"),
    "wrong": ({"verdict": "fail", **reasons_of(IMPRECISE)}, None, "scan-again"),
    "drifted": ({"comparison": comparison()}, DRIFTED, "calibrate"),
}


@pytest.mark.parametrize("state", STATES)
def test_pages_report_and_answers_agree(seeded, store, worker, state):
    changes, log, button = STATES[state]
    identifier = seeded.post("/v1/calibrations", json={"scan_id": "example"}).json()["id"]
    worker.finish_calibration(**changes)
    if state != "good":  # the pictures of the report take a second, and say the same in each state
        store.files.result(kinds.CALIBRATE, identifier, "result.h5").unlink()
    if log is not None:
        seeded.post("/v1/drifts", json={"scan_id": "example"})
        coded = CodedReason.of(log)
        worker.finish_drift(ray_change_mm=0.8, within_tolerance=False, reason=coded.sentence, coded_reason=coded)
    step = seeded.get(f"/v1/calibrations/{identifier}/next-step").json()
    assert (step, step["button"]) == (seeded.get("/v1/scanners/example/next-step").json(), button)
    alone = seeded.get(f"/v1/calibrations/{identifier}").json()["next_step"]
    assert alone["button"] == ("accept" if state == "drifted" else button)  # a log is no part of the calibration
    places = ("/", "/scanners/example", f"/calibrate?calibration={identifier}", f"/calibrations/{identifier}/report")
    pages = {path: seeded.get(path).text for path in places}
    for path, html in pages.items():
        assert step["headline"] in shown(html), path
        assert step["action"] in shown(html), path
    verdict = pages[f"/calibrate?calibration={identifier}"]
    primary = re.search(r'class="(?:button )?primary large"[^>]*>([^<]*)<', verdict)[1]
    assert primary == {"accept": "Accept", "scan-again": "Scan again", "calibrate": "Calibrate"}[button]
    events = seeded.get("/v1/events?duration_s=0.05&after=0").text
    assert f'"headline":{json.dumps(step["headline"])}' in events.replace('": ', '":')
