"""From an empty data folder to the accepted calibration, in a browser in front of `sawmill serve`."""

import re

import numpy as np
import pytest
from live_service import SCANNER
from page_checks import looks_right
from playwright.sync_api import Route, expect

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.scans import ScanSpec
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Theta
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM
from sawmill_tomography.projection.simulate import simulate_stack
from sawmill_vocabulary import DataKind, Progress

pytestmark = pytest.mark.slow

THETA = Theta(0.7, 728.0, -254.0, -37.0, -0.21)
VIEWS = 60
DROP = """text => {
  const dataTransfer = new DataTransfer();
  dataTransfer.items.add(new File([text], "letter.txt"));
  document.querySelector("main").dispatchEvent(new DragEvent("drop", {dataTransfer, bubbles: true}));
}"""


def test_from_an_empty_folder_to_the_accepted_calibration(page, service, tmp_path):
    # Counts of the phantom with flat and dark fields, and without the angles: they begin at 3 degrees.
    angles = (np.arange(VIEWS) + 0.5) * TAU / VIEWS
    stack = simulate_stack([L_SHAPE.of_density(SAPWOOD_PER_MM)], FanBeamGeometry(SCANNER, THETA, angles), seed=3)
    scan_path = tmp_path / "morning.npz"
    np.savez(scan_path, projections=stack.counts, flats=stack.flats, darks=stack.darks)
    page.goto("/calibrate")
    looks_right(page, "calibrate-file")

    # A file that is no scan, dropped anywhere on the page, once its script listens.
    page.wait_for_load_state("load")
    page.evaluate(DROP, "Dear editor, " * 100)
    expect(page.get_by_role("heading", name="The file is no scan that the service can read")).to_be_visible()
    looks_right(page, "calibrate-refused")
    page.get_by_role("link", name="Choose another file").click()

    # An upload that is cancelled: once before the service has answered that it waits for the file, once after.
    waiting: list[Route] = []

    def hold(route: Route) -> None:
        waiting.append(route)

    page.route("**/v1/uploads", hold)
    with page.expect_request("**/v1/uploads"):
        page.get_by_label("Choose the phantom's scan").set_input_files(scan_path)
    page.get_by_role("button", name="Cancel").click()
    with page.expect_request(lambda request: request.method == "DELETE"):
        waiting[0].continue_()
    expect(page.get_by_role("alert")).to_have_text("Sending was cancelled. Nothing of it is kept.")
    page.unroute("**/v1/uploads")

    page.route("**/v1/uploads/*", lambda _: None)
    with page.expect_request("**/v1/uploads/*"):
        page.get_by_label("Choose the phantom's scan").set_input_files(scan_path)
    page.get_by_role("button", name="Cancel").click()
    expect(page.get_by_role("alert")).to_have_text("Sending was cancelled. Nothing of it is kept.")
    page.unroute("**/v1/uploads/*")

    # A connection that breaks after half of the file: the rest follows by itself.
    offsets = []

    def half(route: Route) -> None:
        if route.request.method != "PATCH":
            route.continue_()
            return
        offsets.append(int(route.request.headers["upload-offset"]))
        if len(offsets) == 1:
            content = scan_path.read_bytes()
            page.request.patch(route.request.url, headers={"Upload-Offset": "0"}, data=content[: len(content) // 2])
            route.abort()
        else:
            route.continue_()

    page.route("**/v1/uploads/*", half)

    # What the file does not say: the scanner, filled in from it, the phantom and the angles, first a wrong one.
    page.get_by_label("Choose the phantom's scan").set_input_files(scan_path)
    expect(page.get_by_role("heading", name="What the file says")).to_be_visible()
    assert offsets == [0, scan_path.stat().st_size // 2]
    facts = page.locator("dl.facts")
    expect(facts).to_contain_text("morning.npz")
    expect(facts).to_contain_text("60")
    expect(page.get_by_text("What are the numbers?")).to_have_count(0)
    expect(page.get_by_alt_text("Picture of the scan in the file")).to_have_js_property("naturalWidth", 320)
    page.get_by_label("At which angles were the views taken").fill("3:six")
    page.get_by_role("link", name="Describe a scanner").click()
    expect(page.get_by_label("Detector cells")).to_have_value(str(SCANNER.num_detector_pixels))
    page.get_by_label("Name").fill("Line 2")
    page.get_by_label("Detector pitch").fill(str(SCANNER.detector_pitch_mm).replace(".", ","))
    page.get_by_role("button", name="Add this scanner").click()
    expect(page.get_by_text("Source to turning axis: This is needed.")).to_be_visible()
    looks_right(page, "calibrate-new-scanner")
    page.get_by_label("Source to turning axis").fill(str(SCANNER.source_to_cor_mm))
    page.get_by_role("button", name="Add this scanner").click()
    page.get_by_role("link", name="Another phantom").click()
    page.locator("#draw").get_by_label("Name").fill("our board")
    page.get_by_role("button", name="Save the phantom").click()
    expect(page.get_by_label("our board")).to_be_checked()
    expect(page.get_by_label("Line 2")).to_be_checked()
    expect(page.get_by_label("At which angles were the views taken")).to_have_value("3:six")
    page.get_by_label(re.compile("l-shape", re.IGNORECASE)).check()
    looks_right(page, "calibrate-questions")
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="The angles cannot be read")).to_be_visible()
    page.get_by_text("Details", exact=True).click()
    expect(page.get_by_text("an angle must be a number of degrees, not 'six'")).to_be_visible()
    looks_right(page, "calibrate-failed")

    # The same file with other answers: nothing is sent again, and a reload comes back to the search.
    page.get_by_role("link", name="Try again with other answers").click()
    expect(page.get_by_label(re.compile("l-shape", re.IGNORECASE))).to_be_checked()
    expect(page.get_by_label("At which angles were the views taken")).to_have_value("3:six")
    page.get_by_label("At which angles were the views taken").fill("3,0:6")
    page.get_by_role("button", name="Calibrate", exact=True).click()
    page.wait_for_url(re.compile("calibration="))
    page.reload()
    expect(page.get_by_role("heading", name="Are the rays right?")).to_be_visible()
    expect(page.get_by_text("In 95 of 100 cases the rays are off by less than")).to_be_visible()
    looks_right(page, "calibrate-result")
    accept, outlined = page.get_by_role("button", name="Accept"), page.get_by_role("button", name="Enlarge the picture")
    assert outlined.bounding_box()["y"] + outlined.bounding_box()["height"] < accept.bounding_box()["y"]
    outlined.click()
    smaller = page.get_by_role("button", name="Make smaller").bounding_box()
    assert smaller == {"x": 0, "y": 0, "width": 390, "height": 844}
    page.keyboard.press("Escape")
    accept.click()
    expect(page.get_by_text("This is the active calibration")).to_be_visible()
    (scanner,) = service.get("/v1/scanners").json()["items"]
    active = scanner["active_calibration_id"]
    assert active is not None
    assert f"calibration={active}" in page.url

    # Files that are no scans, in Finnish: a photo, and the result that was just made, which is opened instead.
    for name, content, sentence in [
        ("kuva.jpg", b"\xff\xd8\xff\xe0\x00\x10JFIF", "Tämä on kuva eikä skannaus"),
        ("tulos.json", service.get(f"/v1/calibrations/{active}").content, "Tämä on kalibrointi eikä skannaus"),
    ]:
        page.goto("/look?language=fi&next=/calibrate")
        sent = {"name": name, "mimeType": "", "buffer": content}
        page.get_by_label("Valitse kalibrointikappaleen skannaus").set_input_files(sent)
        expect(page.get_by_role("heading", name=sentence)).to_be_visible()
        looks_right(page, name.partition(".")[0])
    page.get_by_role("link", name="Avaa tämä kalibrointi").click()
    expect(page.get_by_text("Tämä kalibrointi on käytössä")).to_be_visible()


@pytest.mark.usefixtures("seeded")
def test_the_search_is_followed_live_and_cancelled(site, store):
    asked = store.calibrations.accept(CalibrationRequest(scan_id="example"))
    page = site.open("/login", viewport={"width": 800, "height": 700})
    # As a proxy answers while the service starts: a browser does not ask again by itself.
    page.route(f"**/v1/jobs/{asked.job_id}/events", lambda route: route.fulfill(status=503), times=1)
    page.goto(f"/calibrate?calibration={asked.id}")
    stage = page.locator("#follow-stage")
    expect(stage).to_have_text("Waiting for its turn")
    claim = store.jobs.claim("test")
    store.jobs.heartbeat(claim, Progress(fraction=0.4, stage="search", best_value=0.01234))
    expect(stage).to_have_text("Searching for the geometry")
    expect(page.get_by_role("progressbar")).to_have_js_property("value", 0.4)
    expect(page.locator("#follow-more")).to_contain_text("best value so far: 0.0123")
    looks_right(page, "calibrate-search")
    page.get_by_role("button", name="Cancel").click()
    while not store.jobs.heartbeat(claim):
        page.wait_for_timeout(10)
    store.jobs.cancelled(claim)
    expect(page.get_by_role("heading", name="The calibration was cancelled")).to_be_visible()


@pytest.mark.usefixtures("seeded")
def test_the_page_goes_on_when_a_phantom_s_scan_comes_and_its_button_sends_once_and_again_after_going_back(
    site, store, worker
):
    page = site.open("/calibrate?scanner=example")
    expect(page.get_by_text("Waiting for the phantom's scan of Line <2>")).to_be_visible()
    for phantom in (None, "l-shape"):
        spec = ScanSpec(scanner_id="example", data=DataKind.LINE_INTEGRALS, phantom_id=phantom)
        scan = store.scans.accept(spec, store.files.receive([b"original"], max_bytes=100))
        worker.finish_scan()
    page.wait_for_url(f"**/calibrate?scanner=example&scan={scan.id}")
    expect(page.get_by_label(re.compile("l-shape", re.IGNORECASE))).to_be_checked()
    looks_right(page, "calibrate-arrived")
    page = site.open("/calibrate?scan=example")
    button = page.get_by_role("main").get_by_role("button", name="Calibrate")
    assert button.evaluate("button => { button.click(); return button.disabled; }")
    page.wait_for_url("**/calibrate?calibration=*")
    page.go_back()
    expect(button).to_be_enabled()
