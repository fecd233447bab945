"""From the files of one passage through two fixed pairs to places that two passages show, in a browser."""

import json
import re

import pytest
from page_checks import looks_right
from playwright.sync_api import expect
from recorded_apart import recorded_apart

from sawmill_command.seeding import RECORDED, RECORDED_LOG, RECORDED_PAIRS
from sawmill_contracts.fixed_pairs import DECLARATION

pytestmark = pytest.mark.slow

PLACES = {"pairs": DECLARATION.to_ask.example["body"]["pairs"]}


def test_one_passage_is_watched_and_the_second_goes_on_from_it(page, service, tmp_path):
    apart = recorded_apart([RECORDED / name for name in RECORDED_PAIRS.values()], tmp_path)
    files = apart[:2], apart[2:]
    page.goto("/calibrate")
    page.get_by_role("link", name=re.compile("fixed pairs")).click()
    places = page.get_by_label("Nominal places of the pairs")
    first = page.get_by_label("Choose the files of all pairs")
    page.get_by_label("Board").select_option("l-shape")
    page.get_by_label("What are the numbers?").select_option("counts")
    looks_right(page, "fixed-pairs-files")

    # A file too few, and places that are none; what was sent is not sent again.
    places.fill(json.dumps(PLACES))
    first.set_input_files(files[0][:1])
    page.get_by_role("button", name="Calibrate").click()
    expect(page.get_by_role("alert")).to_have_text("Choose a file for each of the 2 pairs: there are 1.")
    first.set_input_files(files[0][::-1])
    expect(page.locator(".order li")).to_have_text([path.name for path in files[0]])
    places.fill(json.dumps({"pairs": [pair | {"source_to_detector_mm": 1.0} for pair in PLACES["pairs"]]}))
    page.get_by_role("button", name="Calibrate").click()
    expect(page.get_by_role("alert")).to_contain_text("the centre lies between source and detector")
    places.fill(json.dumps(PLACES))
    page.get_by_role("button", name="Calibrate").click()

    expect(page.get_by_text("Roll the board by about a quarter of a turn").first).to_be_visible()
    expect(page.get_by_role("heading", name="Pass the board again")).to_be_visible()
    looks_right(page, "fixed-pairs-watch")
    page.get_by_label("Choose the files of the next passage").set_input_files(files[1])
    page.get_by_role("button", name="Calibrate").click()

    ring = page.get_by_alt_text("Sources, detectors and the board, with the bound of the rays of each pair")
    expect(page.get_by_role("heading", name="Pass the board again")).to_have_count(0)
    expect(ring).to_have_js_property("complete", True)
    assert ring.evaluate("picture => picture.naturalWidth") > 500
    expect(page.get_by_role("heading", name=re.compile("Pair 2: rays below 0.0"))).to_be_visible()
    looks_right(page, "fixed-pairs-result")
    newest, earlier = service.get("/v1/fixed-pairs").json()["items"]
    assert (earlier["result"]["verdict"], newest["result"]["verdict"]) == ("watch", "pass")
    assert newest["options"]["inspection_ids"][:2] == earlier["options"]["inspection_ids"]
    assert (len(newest["result"]["passages"]), len(service.get("/v1/inspections").json()["items"])) == (2, 4)

    # A log that passes the calibrated pairs shows its nails; one file too few does not leave the page.
    page.get_by_label("Choose the files of a log").set_input_files(RECORDED / RECORDED_LOG["example-log-1"])
    page.get_by_role("button", name="Find the marks").click()
    expect(page.get_by_role("alert")).to_have_text("Choose a file for each of the 2 pairs: there are 1.")
    page.get_by_label("Choose the files of a log").set_input_files([RECORDED / name for name in RECORDED_LOG.values()])
    page.get_by_role("button", name="Find the marks").click()
    expect(page.get_by_role("heading", name="3 marks")).to_be_visible()
    expect(page.get_by_text("or elsewhere: its marks fit other places too")).to_have_count(2)
    across = page.get_by_role("img", name="Across the feed: x down, y to the right")
    assert [float(at.get_attribute("cx")) for at in across.locator("circle").all()] == pytest.approx(
        [-74, 39, -73], abs=2
    )
    looks_right(page, "pair-log")
    page.get_by_role("link", name="Calibration of the pairs, and another log").click()
    expect(page.get_by_text("Not shown")).to_be_visible()
