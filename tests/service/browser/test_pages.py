"""Phantoms, plans, jobs and their streams, keys and scanners, worked on in a browser."""

import re
from pathlib import Path

import pytest
from page_checks import overflowing, shot
from playwright.sync_api import Page, expect

import sawmill_service
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.plans import PlanRequest
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_vocabulary import Progress

PICTURE = Path(sawmill_service.__file__).parent / "static/phantom.png"
TABLET, PHONE = {"width": 800, "height": 1100}, {"width": 390, "height": 844}
STREAMS = """window.streams = [];
window.EventSource = class extends EventSource { constructor(url) { super(url); window.streams.push(this); } };"""
SENTENCE = "the phantom is larger than the detector sees: take a smaller one"
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("seeded")]


def ask(store) -> str:
    return store.plans.accept(PlanRequest(scanner_id="example"), given={"phantom_id": "l-shape"}).job_id


def seen(page: Page, *, yes: bool) -> None:
    hidden = "false" if yes else "true"
    page.evaluate(f"Object.defineProperty(document, 'hidden', {{configurable: true, get: () => {hidden}}})")
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")


def look(page: Page, name: str) -> None:
    """Keep a picture, and see that nothing is cut off."""
    shot(page, name)
    assert overflowing(page) == []


def test_a_phantom_is_drawn_measured_and_another_one_traced(site, store, worker):
    page = site.open("/phantoms/new", viewport=TABLET)
    page.get_by_label("Name").first.fill("our board")
    corner = page.get_by_label("Corner 2, x in mm")
    # The second corner beside the first: the third side crosses the first.
    page.get_by_label("Corner 1, y in mm").fill("160")
    fault = page.locator(".fault")
    expect(fault).to_contain_text("shape 1 is a polygon that")
    expect(page.locator("#preview .wrong")).to_have_count(1)
    look(page, "new-phantom-800-wrong")
    page.get_by_label("Corner 1, y in mm").fill("-150")
    expect(fault).to_be_hidden()
    corner.fill("120,5 mm")
    page.get_by_role("button", name="Save the phantom").click()
    expect(page.locator("#refused")).to_contain_text("Write numbers like 12.5 or 12,5")
    expect(corner).to_have_attribute("aria-invalid", "true")
    corner.fill("120,5")
    expect(page.locator("#refused")).to_be_hidden()
    page.get_by_role("button", name="Add a disc").click()
    page.locator(".shape").nth(1).get_by_label("It is").select_option("a hole")
    expect(page.locator("#preview .hole")).to_have_count(1)
    look(page, "new-phantom-800")
    page.get_by_role("button", name="Save the phantom").click()

    expect(page.get_by_role("heading", name="our board")).to_be_visible()
    expect(page.get_by_text("Not measured")).to_be_visible()
    drawn = page.url
    page.get_by_text("Measure it again").click()
    page.get_by_label("Side y, mm").fill("20")
    page.get_by_role("button", name="Save the measurement").click()
    expect(page.get_by_role("alert")).to_contain_text("y was measured as 20 mm and is drawn 300 mm long")
    page.get_by_label("Side y, mm").fill("")
    page.get_by_label("Side y, mm").press_sequentially("299,4")
    page.get_by_label("How exact").fill("0,05 mm")
    page.get_by_role("button", name="Save the measurement").click()
    expect(page.get_by_role("alert")).to_contain_text("the marked fields cannot be read")
    page.get_by_label("How exact").fill("")
    page.get_by_label("How exact").press_sequentially("0,05")
    page.get_by_label("Instrument").fill("caliper 12")
    page.get_by_role("button", name="Save the measurement").click()
    expect(page.get_by_text("Measured today by caliper 12")).to_be_visible()
    assert page.url != drawn
    drawing = store.phantoms.get(page.url.rsplit("/", 1)[1]).drawing
    assert [(each.measured_mm, each.standard_uncertainty_mm) for each in drawing.measurements] == [(299.4, 0.05)]
    assert drawing.extent_mm[0] == 220.5
    page.set_viewport_size(PHONE)
    look(page, "phantom-390")

    page.goto("/phantoms/new")
    form = page.locator("#picture")
    form.get_by_label("Picture", exact=True).set_input_files(PICTURE)
    form.get_by_label("Name").fill("ell")
    form.get_by_label("Width of the whole picture").fill("400")
    form.get_by_role("button", name="Upload and trace").click()
    expect(page.get_by_role("heading", name="The outline is being traced")).to_be_visible()
    worker.finish_tracing()
    expect(page.get_by_role("heading", name="Does the outline follow the wood?")).to_be_visible()
    look(page, "traced-390")


def test_a_plan_is_asked_for_and_answered_in_words(site, worker):
    page = site.open("/phantoms/rectangle-with-hole", viewport=PHONE)
    page.get_by_label("Scanner", exact=True).select_option("example")
    page.get_by_role("button", name="Compute the plan").click()
    expect(page.get_by_text("Being computed.")).to_be_visible()
    worker.finish_plan()
    expect(page.get_by_text("Are the millimetres right?")).to_be_visible()
    look(page, "plan-390")


@pytest.mark.parametrize(
    ("path", "script"),
    [("/phantoms/new", "new_phantom.js"), ("/phantoms/l-shape", "phantom.js"), ("/system", "system.js")],
)
def test_forms_wait_for_the_script_that_sends_them(site, path, script):
    """A browser that sends such a form itself loads the page again, without what was written."""
    page, held = site.open("/help"), []
    page.route(f"**/{script}", lambda route: held.append(route))  # noqa: PLW0108 - Playwright marks what it calls
    page.goto(path, wait_until="commit")
    buttons = page.locator("form:not([method]) button:not([type=button])")
    page.locator("footer").wait_for()
    count = buttons.count()
    assert count
    expect(buttons.and_(page.locator(":disabled"))).to_have_count(count)
    held[0].continue_()
    expect(buttons.and_(page.locator(":enabled"))).to_have_count(count)


def test_jobs_are_followed_and_cancelled_and_keys_end(site, store, worker):
    page = site.open("/login", viewport=PHONE)
    page.add_init_script(STREAMS)
    page.goto("/jobs")
    expect(page.get_by_text("0 jobs run, 0 wait.")).to_be_visible()
    seen(page, yes=False)
    assert page.evaluate("streams.map(each => each.readyState)") == [2], "closed: nobody looks"
    ask(store)
    seen(page, yes=True)
    expect(page.get_by_text("0 jobs run, 1 waits.")).to_be_visible()
    claim = worker.claim()
    store.jobs.heartbeat(claim, Progress(fraction=0.42, stage="views"))
    expect(page.get_by_text("42 %")).to_be_visible()
    assert page.evaluate("streams.filter(each => each.readyState < 2).length") == 1
    ask(store)
    expect(page.get_by_text("Next in line")).to_be_visible()
    look(page, "jobs-390")
    store.jobs.fail(claim, Failure(kind=FailureKind.INPUT, code="phantom-too-large", detail=SENTENCE))
    expect(page.get_by_text(SENTENCE)).to_be_visible()
    page.get_by_text("1 attempt", exact=True).first.click()
    expect(page.get_by_text("attempt 1 failed for good")).to_be_visible()
    page.get_by_text("Cancel", exact=True).click()
    page.get_by_role("button", name="Yes, cancel it").click()
    expect(page.get_by_text("0 jobs run, 0 wait.")).to_be_visible()
    expect(page.get_by_text("Cancelled", exact=True).last).to_be_visible()
    page.goto("/system")
    page.get_by_text("Make a key", exact=True).click()
    page.get_by_label("Whose it is").fill("line 2")
    page.get_by_label("What it may do").select_option("submit")
    page.get_by_role("button", name="Make the key").click()
    expect(page.get_by_label("The secret", exact=True)).to_have_value(re.compile("^sawmill_"))
    look(page, "system-390")
    page.reload()
    assert "sawmill_" not in page.content()
    page.get_by_text("Revoke", exact=True).click()
    page.get_by_role("button", name="Yes, revoke it").click()
    expect(page.locator(".key")).to_contain_text("Revoked")
    assert store.keys.all()[0].revoked_at is not None


FOLLOW = """path => {
  window.heard = [];
  window.stream = new EventSource(path);
  for (const name of ["job", "end", "closing"]) {
    window.stream.addEventListener(name, event => {
      window.heard.push({name, id: event.lastEventId, data: JSON.parse(event.data)});
    });
  }
}"""


def test_an_event_source_goes_on_with_the_next_service_and_ends_for_good(browser, serve, store, worker):
    asked = store.calibrations.accept(CalibrationRequest(scan_id="example"))
    with serve(0) as port:
        page = browser.new_page(base_url=f"http://127.0.0.1:{port}", bypass_csp=True)
        page.goto("/problems/")
        page.evaluate(FOLLOW, f"/v1/jobs/{asked.job_id}/events")
        claim = worker.claim()
        store.jobs.heartbeat(claim, Progress(fraction=0.25, stage="search"))
        page.wait_for_function("heard.some(({data}) => data.progress?.fraction === 0.25)")
    page.wait_for_function("heard.at(-1).name === 'closing' && stream.readyState === EventSource.CONNECTING")
    store.jobs.heartbeat(claim, Progress(fraction=0.5, stage="search"))  # while nobody listens
    with serve(port):
        page.wait_for_function("heard.some(({data}) => data.progress?.fraction === 0.5)")
    page.wait_for_function("heard.filter(({name}) => name === 'closing').length === 2")
    store.jobs.release(claim)
    worker.finish_calibration()
    with serve(port):
        # It was not closed by the page: it came back after the end, and was answered that nothing follows.
        page.wait_for_function("stream.readyState === EventSource.CLOSED")
        heard = page.evaluate("heard")
    page.context.close()
    assert [event["name"] for event in heard].count("end") == 1
    assert [(event["name"], event["data"]) for event in heard[-1:]] == [("end", "succeeded")]
    assert (heard[-2]["name"], heard[-2]["data"]["state"]) == ("job", "succeeded")
    latest, ended = store.events.numbers_of_job(asked.job_id)
    assert [event["id"] for event in heard[-2:]] == [str(latest), str(ended)]
    ids = [int(event["id"]) for event in heard]
    assert ids == sorted(ids)


PAGE = "/scanners/example"


def split(page: Page) -> float:
    """Where the picture after begins, in per cent from the left, as it is clipped."""
    clip = page.locator(".over").evaluate("image => getComputedStyle(image).clipPath")
    return float(re.search(r"([\d.]+)%\)$", clip)[1])


def test_a_calibration_is_compared_accepted_and_rolled_back(site, store, newer):
    page = site.open(PAGE, viewport={"width": 390, "height": 844})
    page.get_by_label("How much of the picture before is shown").focus()
    assert split(page) == 50
    page.keyboard.press("ArrowLeft")
    assert split(page) == 49
    page.keyboard.press("Home")
    assert split(page) == 0
    box = page.locator(".stack").bounding_box()
    page.mouse.move(box["x"] + 10, box["y"] + 50)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 60)
    page.mouse.up()
    assert (split(page), overflowing(page)) == (pytest.approx(75, abs=1), [])
    shot(page, "scanner-story-390")
    # Nothing has compared it with the one in use: accepting is not the next step, and asks once.
    sure = page.get_by_role("button", name="Yes, accept it")
    expect(sure).to_be_hidden()
    page.get_by_text("Accept all the same", exact=True).click()
    sure.click()
    expect(page.get_by_text("This is the active calibration")).to_be_visible()
    assert store.scanners.get("example").active_calibration_id == newer
    # Rolling back asks once, and says what will happen.
    really = page.get_by_role("button", name="Yes, roll back")
    expect(really).to_be_hidden()
    page.get_by_text("Roll back", exact=True).click()
    expect(page.get_by_text("use this calibration again. Nothing is deleted")).to_be_visible()
    page.get_by_label("Why").fill("the turntable was straightened")
    really.click()
    # What was just rejected is not offered again: the way back is in the history.
    expect(page.get_by_role("heading", name="Calibration in use")).to_be_visible()
    expect(page.get_by_text("Accept all the same", exact=True)).to_have_count(0)
    expect(page.locator(".entries li").first).to_contain_text("the turntable was straightened")
    assert store.scanners.get("example").active_calibration_id == "example"


def test_values_schedules_and_settings(site, store):
    page = site.open(PAGE, viewport={"width": 800, "height": 900}, timezone_id="Asia/Tokyo")
    chart, readout = page.get_by_role("slider", name="Measurements"), page.locator("#readout")
    page.get_by_role("link", name="2 years").focus()
    page.keyboard.press("Tab")
    expect(chart).to_be_focused()
    expect(readout).to_contain_text("drift check · Rays moved 0.010")
    page.keyboard.press("ArrowLeft")
    expect(readout).to_contain_text("calibration · Rays moved not known")
    assert "calibration" in chart.get_attribute("aria-valuetext")
    page.locator(".values use").nth(0).hover(force=True)
    expect(readout).to_contain_text("Rays moved")
    page.get_by_text("Add a schedule").click()
    page.get_by_label("Days", exact=True).select_option("Every Monday")
    page.get_by_label("Time of day").fill("04:15")
    # That of the browser, until another is chosen.
    expect(page.get_by_label("Time zone of the mill")).to_have_value("Asia/Tokyo")
    page.get_by_label("Time zone of the mill").fill("Europe/Helsinki")
    page.get_by_role("button", name="Add this schedule").click()
    mine = page.locator(".entries li").filter(has_text="Every Monday at 04:15, Europe/Helsinki")
    expect(mine).to_be_visible()
    mine.get_by_role("button", name="Delete this schedule").click()
    expect(page.get_by_role("heading", name="Schedules")).to_be_visible()
    expect(page.locator(".entries li").filter(has_text="Every Monday")).to_have_count(0)
    page.get_by_text("Change the settings").click()
    page.get_by_label("Name").fill("Line 7")
    page.get_by_label("Source to turning axis").fill("-859")
    page.get_by_role("button", name="Save the settings").click()
    expect(page.get_by_text("must be more than 0, not -859")).to_be_visible()
    expect(page.get_by_label("Name")).to_have_value("Line 7")
    page.get_by_label("Source to turning axis").fill("860")
    page.get_by_role("button", name="Save the settings").click()
    expect(page.get_by_role("heading", name="Line 7")).to_be_visible()
    assert store.scanners.get("example").constants.source_to_cor_mm == 860.0


def test_a_log_is_brought_by_hand_on_the_list_of_scans(site, store, tmp_path):
    (tmp_path / "log.npz").write_bytes(b"a scan" * 1000)
    page = site.open("/scans")
    page.get_by_text("Bring a file by hand").click()
    page.get_by_label("Choose the scan of a log").set_input_files(tmp_path / "log.npz")
    assert store.scans.page().items[0].id == "example-spare"  # the numbers are asked for first
    bring = page.locator("#bring-answers")
    bring.get_by_label("Scanner").select_option("example")
    bring.get_by_label("What are the numbers?").select_option("line-integrals")
    page.get_by_label("Choose the scan of a log").set_input_files(tmp_path / "log.npz")
    expect(page).to_have_url(re.compile(r"/scans/[0-9a-f]{32}#reconstruct"))
    scan = store.scans.page().items[0]
    assert (scan.name, scan.scanner_id, scan.data, scan.size_bytes) == ("log.npz", "example", "line-integrals", 6000)
