"""The pages of phantoms, as HTML."""

from datetime import date, timedelta
from pathlib import Path

import pytest
from page_text import text_of

import sawmill_service
from sawmill_contracts.phantoms import PhantomDrawing, SizeMeasurement
from sawmill_vocabulary import Disc

PICTURE = (Path(sawmill_service.__file__).parent / "static/phantom.png").read_bytes()
SQUARE = {"kind": "polygon", "vertices_mm": [[-50, -50], [50, -50], [50, 50], [-50, 50]]}


def disc(store, *measurements: SizeMeasurement) -> str:
    drawing = PhantomDrawing(
        name="<round>", shapes=[Disc(center_mm=(0, 0), radius_mm=50)], measurements=list(measurements)
    )
    return store.phantoms.create(drawing).id


def measured(days_ago: int, expires_in_days: int | None, axis: str = "x") -> SizeMeasurement:
    today = date.today()  # noqa: DTZ011 - as people count days
    return SizeMeasurement(
        what=axis,
        measured_mm=100.0,
        standard_uncertainty_mm=0.1,
        instrument="caliper 12",
        measured_on=today - timedelta(days=days_ago),
        expires_on=None if expires_in_days is None else today + timedelta(days=expires_in_days),
    )


@pytest.mark.parametrize(
    ("measurement", "word", "sentence"),
    [
        (None, "Not measured", "Its size is as it was drawn: measure its sides."),
        (measured(425, -1), "Measure again", "Measured 14 months ago by caliper 12: measure it again."),
        (measured(60, 20), "Measure soon", "Measured 2 months ago by caliper 12. Measure it again by"),
        (measured(0, 200), "Measured", "Measured today by caliper 12, good until"),
        (measured(-1, 200), "Measured", "Measured on "),
        (measured(3, None), "Measured", "Measured 3 days ago by caliper 12, with no day on which to repeat it."),
    ],
)
def test_the_list_says_how_well_each_size_is_known(client, store, measurement, word, sentence):
    disc(store, *([measurement, measurement.model_copy(update={"what": "y"})] if measurement else []))
    page = client.get("/phantoms")
    text = text_of(page.text)
    first = text[text.index("&lt;round&gt;") :]
    assert first.startswith(f"&lt;round&gt; {word} 100.0 \N{MULTIPLICATION SIGN} 100.0 mm Size known to")
    assert sentence in first
    assert text.count("built in") == 2
    assert "As published" in text


def test_a_side_that_was_not_measured_is_said_to_be_as_drawn(client, store):
    shown = text_of(client.get(f"/phantoms/{disc(store, measured(0, 200, 'y'))}").text)
    assert "Measured along y only" in shown
    assert "Measured today by caliper 12, along y only: along x it is as it was drawn. Measure that side too." in shown


def test_a_phantom_measured_anew_takes_the_place_of_the_old_one_in_the_list(client, store):
    before = disc(store)
    length = {"what": "x", "measured_mm": 99.0, "standard_uncertainty_mm": 0.05}
    newer = client.post(f"/v1/phantoms/{before}/measurements", json={"measurements": [length]}).json()["id"]
    listed = client.get("/phantoms").text
    assert f"/phantoms/{newer}" in listed
    assert f"/phantoms/{before}" not in listed
    assert f'href="/phantoms/{newer}"' in client.get(f"/phantoms/{before}").text
    assert f'href="/phantoms/{before}"' in client.get(f"/phantoms/{newer}").text


def test_a_built_in_phantom_stays_offered_beside_one_that_was_measured(seeded):
    length = {"what": "x", "measured_mm": 199.9, "standard_uncertainty_mm": 0.05}
    newer = seeded.post("/v1/phantoms/l-shape/measurements", json={"measurements": [length]}).json()["id"]
    listed, asked = seeded.get("/phantoms").text, seeded.get("/calibrate?scan=example").text
    for phantom_id in ("l-shape", newer):
        assert f'href="/phantoms/{phantom_id}"' in listed
        assert f'name="phantom_id" value="{phantom_id}"' in asked
    # Both have the same name.
    assert asked.count('<span class="soft">built in</span>') == 2


def test_a_preview_draws_what_it_can_and_names_the_shape_that_is_wrong(client):
    bow = {"kind": "polygon", "vertices_mm": [[-50, -50], [50, 50], [50, -60], [-50, 50]]}
    shown = client.post("/phantoms/preview", json={"shapes": [SQUARE, bow, {"kind": "disc", "center_mm": [0, None]}]})
    faults = {fault["shape"]: fault["sentence"] for fault in shown.json()["faults"]}
    assert "shape 2 is a polygon that crosses itself: side 1" in faults[1]
    assert faults[2].startswith("center_mm.1 ")
    assert shown.json()["svg"].count('class="wood wrong"') == 1
    assert client.post("/phantoms/preview", json={"shapes": [SQUARE]}).json()["faults"] == []
    assert client.post("/phantoms/preview", json={"shapes": []}).json() == {"svg": None, "faults": []}
    for lax in ("50", True):
        disc = {"kind": "disc", "center_mm": [0, 0], "radius_mm": lax}
        drawn = client.post("/phantoms/preview", json={"shapes": [disc]}).json()
        assert drawn["svg"] is None
        assert drawn["faults"][0]["sentence"].startswith("radius_mm should be a valid number, not")
    holes = [SQUARE, {"kind": "disc", "center_mm": [0, 0], "radius_mm": 80, "density": -1}]
    found = client.post("/phantoms/preview", json={"shapes": holes}).json()["faults"]
    assert [fault["shape"] for fault in found] == [1, None]


def test_a_traced_picture_is_shown_under_its_outline(client, worker):
    accepted = client.post("/v1/phantoms/pictures?name=ell&width_mm=400", content=PICTURE).json()
    page = f"/phantoms/{accepted['id']}"
    assert "The outline is being traced" in client.get(page).text
    assert "Being traced" in client.get("/phantoms").text
    worker.finish_tracing()
    traced = client.get(page).text
    assert "Does the outline follow the wood?" in traced
    assert 'viewBox="-200.0 -200.0 400.0 400.0"' in traced
    assert client.get(f"{page}/picture.png").content == PICTURE
    assert client.get(f"{page}/outline.svg").headers["Content-Type"] == "image/svg+xml"


def test_what_is_no_picture_is_refused_with_its_sentence(client, store):
    accepted = client.post("/v1/phantoms/pictures?name=ell&width_mm=400", content=b"no picture").json()
    store.jobs.request_cancel(accepted["job_id"])
    page = client.get(f"/phantoms/{accepted['id']}").text
    assert "The picture could not be traced" in page
    assert "its job was cancelled before it ended" in page


def test_a_plan_is_held_against_the_tolerances_of_its_scanner(seeded):
    page = text_of(seeded.get("/phantoms/l-shape").text)
    assert "Are the rays right?" in page
    assert "In 95 of 100 cases the rays are off by less than 0.0" in page
    assert "Are the millimetres right?" in page
    assert text_of(seeded.get("/phantoms/l-shape/plans").text).strip().startswith("Line &lt;2&gt;, 20 views")


def test_a_phantom_in_use_says_so_and_an_unused_one_goes(seeded):
    refused = seeded.post("/phantoms/l-shape/delete")
    assert refused.status_code == 409
    assert "is built in and stays" in text_of(refused.text.replace("&#39;", "'"))
    assert seeded.post("/phantoms/example-spare/delete").headers["Location"] == "/phantoms"
    assert seeded.get("/phantoms/example-spare").status_code == 404
