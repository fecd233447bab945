"""The slice viewer, used: every value is where the slices' pictures have it, and two logs move together."""

import io
import re
from collections.abc import Callable

import numpy as np
import pytest
from page_checks import overflowing, shot, small_targets
from PIL import Image
from playwright.sync_api import Page, Route, expect
from results import written_by_its_job
from scan_files import new_volume

from sawmill_contracts import kinds
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_store.mill_tables import ReconstructionRow

SIDE, PIXEL_MM = 32, 12.5
LOG = "/v1/reconstructions/example"
PIXELS = """() => {
  const canvas = document.querySelector(".pane canvas");
  const {data, width, height} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  return {data: [...data], width, height};
}"""
# What is shown each time when the first picture has changed: the slice, whose values are there, and one read out.
WATCH = """() => {
  const pane = document.querySelector(".pane"), value = pane.querySelector('[data-slot="value"]');
  const {width, height} = pane.querySelector("canvas");
  window.seen = [];
  const see = () => {
    const {data} = pane.querySelector("canvas").getContext("2d").getImageData(0, 0, width, height);
    seen.push({...pane.dataset, value: value.textContent, grey: [...data].filter((_, n) => n % 4 === 0)});
  };
  new MutationObserver(see).observe(pane, {attributeFilter: ["data-shown", "data-values"]});
}"""
HERE = """name => performance.getEntriesByType("resource").some(entry => entry.name.includes(`/slices/${name}`))"""
LOCAL = """time => new Intl.DateTimeFormat("en-GB", {dateStyle: "medium", timeStyle: "short"}).format(new Date(time))"""
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("seeded")]

# A finger's push goes on for a moment on a busy machine.
WAIT = "await new Promise((done) => setTimeout(done, 100))"
SETTLED_AT_THE_TOP = f"async () => {{ for (let last = -1; scrollY !== last; {WAIT}) last = scrollY; scrollTo(0, 0); }}"


def asymmetric(slices: int) -> np.ndarray:
    """(slice, x, y), a different value in each place: no turn and no mirror of it is itself."""
    s, x, y = np.mgrid[:slices, :SIDE, :SIDE]
    return (0.1 * s + 0.02 * x + 0.0005 * y).astype(np.float32)


def put_volume(store, log_id: str, volume: np.ndarray, *, row_pitch_mm: float, first_slice_mm: float) -> None:
    path = store.files.results(kinds.RECONSTRUCT, log_id) / "volume.h5"
    placed = {"pixel_mm": PIXEL_MM, "row_pitch_mm": row_pitch_mm, "first_slice_mm": first_slice_mm}
    with new_volume(path, volume.shape, **placed) as file:
        file.write(0, volume)
    written_by_its_job(store, path)
    with store.database.write() as session:
        row = session.get(ReconstructionRow, log_id)
        row.result = row.result | {"shape": volume.shape, "pixel_mm": PIXEL_MM, "value_range": [0.0, 4.0]}


@pytest.fixture
def logs(store) -> dict[str, np.ndarray]:
    """Two logs: slices at 0, 10, … 290 mm, and at 20, 40, … 300 mm with twice the values."""
    volumes = {"example": asymmetric(30), "example-sparse": 2.0 * asymmetric(15)}
    put_volume(store, "example", volumes["example"], row_pitch_mm=10.0, first_slice_mm=0.0)
    put_volume(store, "example-sparse", volumes["example-sparse"], row_pitch_mm=20.0, first_slice_mm=20.0)
    return volumes


def shows(page: Page, index: int, pane: int = 0) -> None:
    expect(page.locator(".pane").nth(pane)).to_have_attribute("data-values", str(index))


def pixels(page: Page) -> np.ndarray:
    """(row, column, red green blue opacity) of the first picture."""
    found = page.evaluate(PIXELS)
    return np.array(found["data"], np.uint8).reshape(found["height"], found["width"], 4)


def hover(page: Page, row: int, column: int, pane: int = 0) -> None:
    box = page.locator(".pane canvas").nth(pane).bounding_box()
    page.mouse.move(box["x"] + box["width"] * (column + 0.5) / SIDE, box["y"] + box["height"] * (row + 0.5) / SIDE)


def readout(page: Page, pane: int = 0) -> tuple[float, float, float]:
    text = page.locator(".readout").nth(pane).inner_text()
    return tuple(float(number) for number in re.search(r"x (\S+) mm, y (\S+) mm: (\S+) 1/mm", text).groups())


def test_slices_are_looked_at_with_mouse_and_keys(site, logs):
    page = site.open("/logs/example", viewport={"width": 1280, "height": 800}, accept_downloads=True)
    volume = logs["example"]
    shows(page, 15)
    # As the service's own picture of the values, whose row is +x and whose column is +y.
    drawn = np.asarray(Image.open(io.BytesIO(page.request.get(f"{LOG}/slices/15.png?bits=16").body()))) / 257
    seen = pixels(page)
    assert np.abs(seen[..., 0] - drawn).max() <= 0.51  # rounded to 8 bits
    assert (seen[..., 0] == seen[..., 2]).all()

    for row, column in ((3, 28), (28, 3)):
        hover(page, row, column)
        x, y, value = readout(page)
        # The field's middle is the rotation centre; four digits are shown, and tenths of a millimetre.
        assert (x, y) == pytest.approx(((row - 15.5) * PIXEL_MM, (column - 15.5) * PIXEL_MM), abs=0.06)
        assert value == pytest.approx(volume[15, row, column], rel=1e-3)

    page.mouse.wheel(0, 100)
    shows(page, 16)
    assert readout(page)[2] == pytest.approx(volume[16, 28, 3], rel=1e-3)  # the pointer did not move
    for key, index in (("ArrowRight", 17), ("ArrowDown", 16), ("PageUp", 26), ("End", 29), ("Home", 0), ("PageUp", 10)):
        page.keyboard.press(key)
        shows(page, index)
    page.get_by_label("Next slice").click()
    shows(page, 11)
    expect(page.locator(".where")).to_contain_text("11 (0 … 29) (110 mm)")

    before = pixels(page)
    hover(page, 10, 10)
    page.mouse.down()
    page.mouse.move(300, 300, steps=2)
    page.mouse.up()
    low, high = (float(page.locator(field).input_value()) for field in ("#low", "#high"))
    assert (low, high) != (0.0, 4.0)
    expect(page.locator("#reset")).to_be_visible()
    page.wait_for_function("() => new Promise(requestAnimationFrame)")
    assert (pixels(page) != before).any()
    page.get_by_role("button", name="Reset").click()
    expect(page.locator("#high")).to_have_value("4")
    page.locator("#high").fill("0,05 mm")
    expect(page.get_by_text("the darkest below the brightest")).to_be_visible()
    page.locator("#high").fill("2,0")
    expect(page.get_by_text("the darkest below the brightest")).to_be_hidden()
    page.locator("#colors").select_option("viridis")
    expect(page.locator("#viewer")).to_have_attribute("data-colors", "viridis")
    page.wait_for_function("() => new Promise(requestAnimationFrame)")
    table = np.array(page.request.get("/v1/color-maps").json()["viridis"])
    expected = table[np.clip(np.floor(volume[11] / 2 * 255 + 0.5), 0, 255).astype(int)]
    # A value between two steps may be rounded either way.
    assert np.mean((pixels(page)[..., :3] != expected).any(axis=-1)) < 0.02

    picture = page.locator(".pane canvas")
    whole = picture.bounding_box()["width"]
    picture.click()
    for key, times in (("+", 1.5), ("0", 1.0)):
        page.keyboard.press(key)
        assert picture.bounding_box()["width"] == pytest.approx(times * whole, rel=0.01)
    hover(page, 3, 28)
    page.keyboard.down("Control")
    page.mouse.wheel(0, -200)
    page.keyboard.up("Control")
    expect(page.locator("#viewer")).to_have_attribute("data-zoomed", "")
    hover(page, 3, 28)  # still there: the place under the pointer stays
    assert readout(page)[0] == pytest.approx(-12.5 * PIXEL_MM, abs=0.06)
    picture.dblclick()
    expect(page.locator("#viewer")).not_to_have_attribute("data-zoomed", "")
    shows(page, 11)

    box = page.locator(".navigator canvas").bounding_box()
    assert box["y"] + box["height"] < 800  # in sight below the picture
    page.mouse.click(box["x"] + box["width"] * 0.25, box["y"] + box["height"] / 2)
    shows(page, 7)
    page.wait_for_url(re.compile(r"slice=7.*high=2&colors=viridis"))
    page.get_by_text("Download", exact=True).click()
    with page.expect_download() as download:
        page.get_by_role("link", name="Values (NPY)").click()
    np.testing.assert_array_equal(np.load(download.value.path()), volume[7])
    as_shown = page.get_by_role("link", name="This slice as shown").get_attribute("href")
    assert as_shown == f"{LOG}/slices/7.png?window_low=0&window_high=2&color_map=viridis"
    shot(page, "viewer-1280-light")


def test_a_picture_comes_first_and_the_values_when_the_slider_rests(site, logs):
    page = site.open("/logs/example?slice=10")
    shows(page, 10)
    hover(page, 3, 28)
    page.evaluate(WATCH)
    page.keyboard.press("PageUp")
    shows(page, 20)
    picture, exact = page.evaluate("seen")
    expected = 255 * logs["example"][20] / 4
    for seen, values, within in ((picture, "", 3.0), (exact, "20", 0.51)):  # JPEG is not exact
        assert (seen["shown"], seen["values"]) == ("20", values)
        assert np.abs(np.reshape(seen["grey"], (SIDE, SIDE)) - expected).max() <= within
    assert picture["value"] == "…"
    assert float(exact["value"].removesuffix(" 1/mm")) == pytest.approx(logs["example"][20, 3, 28], rel=1e-3)


@pytest.mark.nightly
def test_a_drag_over_a_hundred_slices_fetches_the_first_and_the_last(site, store):
    put_volume(store, "example", asymmetric(120), row_pitch_mm=10.0, first_slice_mm=0.0)
    page = site.open("/logs/example?slice=60&low=0&high=20")
    shows(page, 60)
    page.wait_for_function(HERE, arg="59.jpg")
    site.requested.clear()
    held: list[Route] = []
    page.route("**/*.jpg?*", lambda route: held.append(route))  # noqa: PLW0108 - Playwright marks what it calls
    slider, box = page.locator("#slice"), page.locator("#slice").bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.05 * box["width"], middle)
    page.mouse.down()
    first = slider.input_value()
    page.mouse.move(box["x"] + 0.95 * box["width"], middle, steps=100)
    page.mouse.up()
    last = slider.input_value()
    assert int(last) - int(first) > 100
    for index in (first, last):
        while not held:
            page.wait_for_timeout(10)
        (picture,) = held
        assert f"/slices/{index}.jpg" in picture.request.url
        held.clear()
        picture.continue_()
    shows(page, int(last))
    assert [re.search(r"(\d+)\.npy", url)[1] for url in site.requested if ".npy" in url] == [last]


def fingers(page: Page) -> Callable[..., None]:
    """Fingers on the screen, as a tablet reports them: where they are, or that they are gone."""
    session = page.context.new_cdp_session(page)

    def press(*points: tuple[float, float], kind: str = "touchStart") -> None:
        touched = [{"x": x, "y": y, "id": n} for n, (x, y) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touched})

    return press


def test_a_knot_is_measured_with_gloves(site, logs):
    """Rulers and regions stay with the log, for every browser; the ± is that of the calibration and of the pixels."""
    page = site.open("/logs/example?slice=10", viewport={"width": 800, "height": 1280}, has_touch=True, locale="fi-FI")
    shows(page, 10)
    press = fingers(page)
    box = page.locator(".stage").bounding_box()
    middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    before = page.locator(".pane canvas").bounding_box()["width"]

    # Two fingers that move apart from 100 to 400 pixels: four times as large, and the place between them stays.
    press(*((middle[0] + side * 50, middle[1]) for side in (-1, 1)))
    for apart in (100, 150, 200):
        press(*((middle[0] + side * apart, middle[1]) for side in (-1, 1)), kind="touchMove")
    press(kind="touchEnd")
    zoomed = page.locator(".pane canvas").bounding_box()
    assert zoomed["width"] == pytest.approx(4 * before, rel=0.01)
    assert zoomed["x"] + zoomed["width"] / 2 == pytest.approx(middle[0], abs=2)

    # One finger scrolls the page, until a tool takes hold of the picture.
    scrolled = []
    for _ in range(2):
        press(middle)
        for up in (20, 60, 120):
            press((middle[0], middle[1] - up), kind="touchMove")
        press(kind="touchEnd")
        scrolled.append(page.evaluate("scrollY"))
        page.evaluate(SETTLED_AT_THE_TOP)
        page.get_by_role("button", name="Siirrä").click()
    assert scrolled[0] > 50 > scrolled[1] == 0
    page.get_by_role("button", name="Mittaa").click()

    # 100 mm along y: the field of 400 mm is as wide as the stage, four times enlarged.
    mm = 4 * min(box["width"], box["height"]) / 400
    press((middle[0] - 40 * mm, middle[1]))
    press((middle[0] + 20 * mm, middle[1]), kind="touchMove")
    press(kind="touchEnd")
    measured = page.locator(".measured")
    expect(measured).to_contain_text(re.compile(r"Pituus 60(,0)? ± "))
    # An end is moved to where it should be.
    press((middle[0] + 20 * mm + 10, middle[1]))
    press((middle[0] + 40 * mm, middle[1]), kind="touchMove")
    press(kind="touchEnd")
    length, error = (float(text.replace(",", ".")) for text in re.findall(r"[\d,]+", measured.inner_text())[:2])
    assert length == pytest.approx(80, abs=0.2)
    known = page.request.get("/v1/calibrations/example").json()
    expected = np.hypot(
        0.8 * known["scale_uncertainty_percent"], np.sqrt(2) * known["predicted_ray_error_mm"]["upper_95"]
    )
    # Of two pixels each anywhere within its own, 95 % are less than 0.776 pixels further or nearer.
    assert error == pytest.approx(np.hypot(expected, 0.776 * PIXEL_MM), abs=0.06)
    assert overflowing(page) + small_targets(page) == []
    page.get_by_label("Huomautus").fill("oksa")
    page.get_by_label("Huomautus").blur()
    shot(page, "viewer-ruler-800-light-fi")

    page.wait_for_url(re.compile(r"view=.*mark="))
    page.reload()
    shows(page, 10)
    expect(measured).to_contain_text("Pituus 80")
    assert page.locator(".pane canvas").bounding_box()["width"] == pytest.approx(4 * before, rel=0.01)
    page.evaluate("scrollTo(0, 0)")
    for _ in range(2):
        page.touchscreen.tap(*middle)
    page.wait_for_function("width => document.querySelector('.pane canvas').clientWidth <= width", arg=before + 1)

    page.get_by_role("button", name="Alue").click()
    mm /= 4
    press((middle[0] - 50 * mm, middle[1] - 100 * mm))
    press((middle[0] + 50 * mm, middle[1] + 100 * mm), kind="touchMove")
    press(kind="touchEnd")
    x, y = (np.mgrid[:SIDE, :SIDE] - 15.5) * PIXEL_MM
    inside = logs["example"][10][(x / 100) ** 2 + (y / 50) ** 2 <= 1]
    mean, spread = (float(text.replace(",", ".")) for text in re.findall(r"[\d]+,[\d]+", measured.inner_text())[:2])
    assert (mean, spread) == pytest.approx((inside.mean(), inside.std()), rel=0.02)

    low = page.locator("#low").input_value()
    page.get_by_role("button", name="Oksat").click()
    expect(page.locator("#low")).not_to_have_value(low)
    page.wait_for_load_state("networkidle")
    second = site.open("/logs/example?slice=3", accept_downloads=True)
    rows = second.locator("#marks li")
    expect(rows).to_have_text([re.compile("Slice 10: 80 ± 9.7 mm"), re.compile(r"Slice 10: \d.*1/mm")])
    expect(rows.first.get_by_label("Note")).to_have_value("oksa")
    rows.first.get_by_role("button").first.click()
    shows(second, 10)
    expect(second.locator(".measured")).to_contain_text("Length 80 ± 9.7 mm")
    rows.nth(1).get_by_label("Remove").click()
    with second.expect_download() as download:
        second.get_by_role("button", name="Save the list").click()
    header, line = download.value.path().read_text("utf-8-sig").splitlines()
    kept = dict(zip(header.split(","), line.split(","), strict=True))
    assert (kept['"kind"'], kept['"note"'], kept['"height_mm"']) == ('"ruler"', '"oksa"', '"100"')
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")  # it is looked at again
    expect(page.locator("#marks li")).to_have_count(1)


def test_two_logs_move_together_by_height(site, logs):
    # A clock that no server has.
    here = {"viewport": {"width": 800, "height": 1100}, "timezone_id": "Pacific/Kiritimati"}
    page = site.open("/logs/example?slice=10&low=0&high=4", **here)
    shows(page, 10)
    other = page.locator(".beside option[data-moment]").first
    local = page.evaluate(LOCAL, other.get_attribute("data-moment"))
    expect(other).to_have_text(f"{other.get_attribute('data-before')} {local}")
    page.get_by_label("Look at another log beside it").select_option("example-sparse")
    page.wait_for_url("**beside=example-sparse**")
    shows(page, 10)
    shows(page, 4, pane=1)  # 100 mm in both
    page.locator("#slice").focus()
    for key in ("PageDown", "ArrowRight", "ArrowRight", "ArrowRight", "ArrowUp"):
        page.keyboard.press(key)
    shows(page, 4)
    shows(page, 1, pane=1)  # 40 mm in both
    hover(page, 20, 5)
    x, y, value = readout(page, pane=1)
    assert (x, y) == pytest.approx((56.25, -131.25), abs=0.06)
    assert value == pytest.approx(logs["example-sparse"][1, 20, 5], rel=1e-3)
    expect(page.locator(".cross").nth(1)).to_be_visible()
    shot(page, "viewer-two-800-light")
    page.keyboard.press("Home")
    shows(page, 0)
    expect(page.locator(".away").nth(1)).to_be_visible()
    page.get_by_role("button", name="To the nearest height that both have").click()
    shows(page, 1)
    shows(page, 0, pane=1)  # within half of the distance between its slices
    # Heights from 0 to 290 mm, and from 20 mm on.
    bars = [page.locator(".navigator .range").nth(n).bounding_box() for n in (0, 1)]
    assert bars[1]["x"] - bars[0]["x"] == pytest.approx(bars[0]["width"] * 2 / 30, abs=2)


@pytest.mark.nightly
def test_a_log_is_waited_for_and_then_looked_at_with_a_finger(site, store, worker):
    log = store.reconstructions.accept(ReconstructionRequest(scan_id="example"))
    page = site.open(f"/logs/{log.id}", viewport={"width": 390, "height": 844}, has_touch=True)
    expect(page.get_by_role("heading", name="It waits for its turn")).to_be_visible()
    worker.finish_reconstruction()
    shows(page, 1)
    page.get_by_label("Next slice").tap()
    shows(page, 2)
    page.get_by_label("Previous slice").tap()
    shows(page, 1)
    page.locator(".pane canvas").tap(position={"x": 40, "y": 300})
    x, y, _ = readout(page)
    assert x > 0 > y  # low in the picture and on its left
    assert overflowing(page) + small_targets(page) == []
    shot(page, "viewer-390-light")
