"""Phantoms drawn, measured and traced; jobs that are followed and cancelled; keys made and revoked."""

import re
from pathlib import Path

import pytest
from page_checks import overflowing, shot
from playwright.sync_api import Page, expect

import sawmill_service
from sawmill_contracts.plans import PlanAsk
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_vocabulary import Progress

PICTURE = Path(sawmill_service.__file__).parent / "static/phantom.png"
TABLET, PHONE = {"width": 800, "height": 1100}, {"width": 390, "height": 844}
STREAMS = """window.streams = [];
window.EventSource = class extends EventSource { constructor(url) { super(url); window.streams.push(this); } };"""
SENTENCE = "the phantom is larger than the detector sees: take a smaller one"
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("seeded")]


def ask(store) -> str:
    """A plan's job."""
    return store.plans.accept(PlanAsk(scanner_id="example"), given={"phantom_id": "l-shape"}).job_id


def seen(page: Page, *, yes: bool) -> None:
    """As when another tab comes before this one, or goes."""
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
    page = site.open("/help")
    held = []
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
    secret = page.get_by_label("The secret", exact=True)
    expect(secret).to_have_value(re.compile("^sawmill_"))
    look(page, "system-390")
    page.reload()
    assert "sawmill_" not in page.content()
    page.get_by_text("Revoke", exact=True).click()
    page.get_by_role("button", name="Yes, revoke it").click()
    expect(page.locator(".key")).to_contain_text("Revoked")
    assert store.keys.all().keys[0].revoked_at is not None
