"""Today on a tablet: it follows the service, says when it hears nothing, and a display on the wall does so too."""

from datetime import timedelta
from zoneinfo import ZoneInfo

import pytest
from page_checks import shot
from playwright.sync_api import expect

from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_service.event_feed import StreamTimes
from sawmill_service.settings import ServiceSettings
from sawmill_store.mill_tables import AlarmRow
from sawmill_vocabulary import DataKind

TOKEN = "Zm9yIHRlc3RzIGFsb25lLCBub3QgYSBzZWNyZXQ"  # noqa: S105 - for tests alone
OUT = {"within_tolerance": False, "ray_change_mm": 0.8, "reason": "the COR moved 0.81 mm: look at the turntable"}
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("seeded")]


@pytest.fixture
def stream_times():
    """A page and a service that notice within half a second what they notice within half a minute."""
    return StreamTimes(lost_s=0.4, access_s=0.2)


def check(store, worker, **changes):
    store.drifts.accept(DriftRequest(scan_id="example"))
    worker.finish_drift(**changes)


def test_a_scanner_goes_red_and_the_service_dies_and_comes_back(browser, serve, store, worker):
    with serve(0) as port:
        page = browser.new_page(base_url=f"http://127.0.0.1:{port}", viewport={"width": 800, "height": 900})
        page.goto("/")
        expect(page.get_by_role("heading", level=1)).to_have_text("1 fine, 1 needs you")
        example = page.locator("#scanner-example")
        page.get_by_role("link", name="Calibrate Line <2>").last.focus()
        check(store, worker, **OUT)
        expect(example).to_contain_text("Out of tolerance")
        expect(page.get_by_role("heading", level=1)).to_have_text("0 fine, 2 need you, 1 of them red")
        expect(page).to_have_title("(1 red + 1) Today · Sawmill calibration")
        assert page.locator(".scanner").evaluate_all("rows => rows.map(row => row.id)")[0] == "scanner-example"
        # The row was replaced and went to the top; who works without a mouse stands where he stood.
        assert page.evaluate("document.activeElement.closest('.scanner').id") == "scanner-example"
        shot(page, "today-red-800")
    expect(page.get_by_role("alert")).to_contain_text("The service does not answer")
    expect(example).to_be_visible()
    shot(page, "today-silent-800")
    check(store, worker)  # while nobody listens
    with serve(port):
        expect(page.get_by_role("alert")).to_be_hidden()
        expect(example).to_contain_text("Fine")
        check(store, worker, **OUT)
        expect(example).to_contain_text("Out of tolerance")
        page.context.close()


def test_rows_that_do_not_come_leave_it_grey_and_older_ones_never_come_last(site, store, worker):
    page = site.open()
    example = page.locator("#scanner-example")
    page.route("**/today/rows", lambda route: route.fulfill(status=503), times=1)
    check(store, worker, **OUT)
    expect(page.get_by_role("alert")).to_contain_text("The service does not answer")
    expect(example).to_contain_text("Fine")
    expect(page.get_by_role("alert")).to_be_hidden()
    assert "Out of tolerance" in example.text_content()
    held = []
    page.route("**/today/rows", lambda route: held.append((route, route.fetch())), times=1)
    check(store, worker)
    while not held:
        page.wait_for_timeout(10)
    check(store, worker, **OUT)
    page.wait_for_timeout(800)  # the newer rows would be there by now
    [(route, older)] = held
    route.fulfill(response=older)
    page.wait_for_timeout(800)
    expect(example).to_contain_text("Out of tolerance")


def test_fifty_scanners_fit_and_one_is_found_by_its_name(site, store, worker):
    spec = store.scanners.get("example")
    for number in range(48):
        store.scanners.create(ScannerSpec(name=f"Mill {number}", constants=spec.constants))
    page = site.open("/", viewport={"width": 800, "height": 900})
    expect(page.locator("#fold-fine summary")).to_have_text("Fine: 1")
    expect(page.locator("#fold-grey summary")).to_have_text("Without a calibration: 49")
    example = page.locator("#scanner-example")
    expect(example).to_be_hidden()
    page.get_by_label("Find a scanner by its name").fill("line <2>")
    expect(example).to_be_visible()
    expect(page.get_by_text("Mill 7", exact=True)).to_be_hidden()
    check(store, worker, **OUT)
    expect(page.locator("#scanners").locator("#scanner-example")).to_contain_text("Out of tolerance")
    expect(page.locator("#fold-fine")).to_be_hidden()
    expect(page.get_by_text("Mill 7", exact=True)).to_be_hidden()


def test_fifty_scanners_of_which_half_need_somebody_fit_on_a_wall(site, store, worker):
    spec = store.scanners.get("example")
    for number in range(48):
        scanner = store.scanners.create(ScannerSpec(name=f"Sorting line {number} north", constants=spec.constants))
        if number % 2:
            of_phantom = ScanSpec(scanner_id=scanner.id, data=DataKind.LINE_INTEGRALS, phantom_id="l-shape")
            scan = store.scans.accept(of_phantom, store.files.receive([b"scan"], max_bytes=100))
            worker.finish_scan()
            store.calibrations.accept(CalibrationRequest(scan_id=scan.id))
            worker.finish_calibration()
    page = site.open("/?kiosk", viewport={"width": 1920, "height": 1080})
    shot(page, "fifty-on-a-wall")
    expect(page.locator("#scanners > .scanner")).to_have_count(24)
    assert page.evaluate("document.documentElement.scrollHeight") <= 1080
    assert page.evaluate("[...document.querySelectorAll('h2')].every((each) => each.scrollWidth <= each.clientWidth)")


def test_an_alarm_is_acknowledged_with_two_touches_and_comes_back_at_its_time(site, store):
    with store.database.write() as session:
        session.add(AlarmRow(scanner_id="example", kind=AlarmKind.NO_PHANTOM_SCAN, since=store.now()))
    page = site.open("/scanners/example", locale="fi-FI", timezone_id="Asia/Tokyo")
    expect(page.get_by_role("heading", name="Tarkkaile")).to_be_visible()
    page.get_by_text("Kuittaa hälytys").click()
    page.get_by_role("button", name="Kuittaa", exact=True).click()
    expect(page.get_by_role("heading", name="Kunnossa")).to_be_visible()
    expect(page.get_by_text("Kuitattu").first).to_contain_text("Huolto")
    (alarm,) = store.alarms.open()
    assert alarm.acknowledged.until.astimezone(ZoneInfo("Asia/Tokyo")).hour in {6, 14, 22}
    store.alarms.acknowledge("example", AlarmKind.NO_PHANTOM_SCAN, store.now() + timedelta(seconds=4), "huolto")
    page.goto("/")
    example = page.locator("#scanner-example")
    expect(example).to_contain_text("Kuitattu")
    expect(example).to_contain_text("Tarkkaile")
    expect(example).not_to_contain_text("Kuitattu")


@pytest.mark.parametrize("settings", [ServiceSettings(token=TOKEN, event_poll_s=0.05)], ids=["with-a-token"])
def test_a_display_follows_until_its_key_ends(site, store, worker):
    key = store.keys.create(KeyRequest(name="display", scope=Scope.READ, display=True))
    page = site.open()
    page.get_by_label("Key", exact=True).fill(key.secret)
    page.get_by_role("button", name="Log in").click()
    expect(page.locator(".scanner")).to_have_count(2)
    expect(page.locator(".scanner .button")).to_have_count(0)
    check(store, worker, **OUT)
    expect(page.locator("#scanner-example")).to_contain_text("Out of tolerance")
    page.goto("/?kiosk")
    red = page.locator("#scanner-example")
    expect(page.locator("#clock")).to_contain_text(":")
    # The colour fills the row, and the name is as tall as a thumb.
    assert (
        page.evaluate("getComputedStyle(document.querySelector('.scanner.bad')).backgroundColor") == "rgb(179, 38, 30)"
    )
    assert red.get_by_role("heading").evaluate("name => parseFloat(getComputedStyle(name).fontSize)") > 60
    page.context.set_offline(True)
    expect(page.get_by_role("alert")).to_contain_text("The service does not answer")
    page.context.set_offline(False)
    expect(page.get_by_role("alert")).to_be_hidden()
    store.keys.revoke(key.id)
    expect(page.get_by_label("Key", exact=True)).to_be_visible()
