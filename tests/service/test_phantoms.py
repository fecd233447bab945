"""Phantoms over HTTP and on their pages."""

import io
from datetime import date, timedelta
from pathlib import Path

import numpy as np
from asgi import absent, refusal, text_of
from PIL import Image, ImageDraw

import sawmill_service
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS, PhantomDrawing, SizeMeasurement
from sawmill_vocabulary import Disc

PICTURE = (Path(sawmill_service.__file__).parent / "static/phantom.png").read_bytes()


def test_the_built_in_ones_stay_and_drawings_are_svg_those_of_an_earlier_version_too(client, store):
    for phantom_id in ("l-shape", "rectangle-with-hole"):
        assert client.get(f"/v1/phantoms/{phantom_id}").json()["state"] == "ready"
        assert client.delete(f"/v1/phantoms/{phantom_id}").json()["code"] == "phantom-built-in"
    answer = client.get("/v1/phantoms/rectangle-with-hole/drawing.svg")
    assert (answer.status_code, answer.headers["Content-Type"]) == (200, "image/svg+xml")
    assert absent(answer.text, "⌀ 52 at (-50, -49)", 'width="360.36mm"') == []
    assert client.get("/v1/phantoms/l-shape/drawing.svg").headers["ETag"] != answer.headers["ETag"]
    kept = store.phantoms.create(PhantomDrawing(name="line", shapes=[LINE]))
    assert client.get(f"/v1/phantoms/{kept.id}").status_code == 200
    assert client.get(f"/v1/phantoms/{kept.id}/drawing.svg").status_code == 200


def test_a_drawing_without_extent_is_a_problem_and_another_is_ready_at_once(client):
    drawing = {"name": "disc", "shapes": [disc(0, 0, 50)]}
    created = client.post("/v1/phantoms", json=drawing)
    assert created.status_code == 201
    assert client.get(created.headers["Location"]).json()["drawing"]["shapes"][0]["radius_mm"] == 50
    refused = client.post("/v1/phantoms", json=drawing | {"follows": "l-shape"})
    assert refused.status_code == 422
    assert "body.follows must be left out, not 'l-shape'" in refused.json()["detail"]
    assert client.post("/v1/phantoms", json=drawing | {"follows": None}).status_code == 201
    created = client.post("/v1/phantoms", json={"name": "board", "shapes": [polygon(*CORNERS, CORNERS[0])]})
    assert (created.status_code, created.json()["drawing"]["shapes"][0]["vertices_mm"]) == (201, SQUARE["vertices_mm"])
    for shapes, reported in (
        ([LINE], "shape 1 is a polygon that encloses 0 mm²"),
        ([SQUARE, polygon((1, 1), (1, 1), (1, 1))], "shape 2 is a polygon that encloses 0"),
        ([disc(100, 0, 1e-300)], "is a disc of radius 1e-300 mm: give at least 0.1 mm"),
        ([{**SQUARE, "density": 1e9}], "has density 1e+09: give one within ±1000"),
        ([SQUARE, {**SQUARE, "density": -1}], "add up to 0 mm²: wood must outweigh holes"),
        ([{**SQUARE, "density": 0}], "add up to 0 mm²"),
        ([{**SQUARE, "density": 1e-300}], "has density 1e-300: give 0 or one of at least 1e-06"),
        ([BOW], "crosses itself: side 1 (corner 1 to 2) meets side 3 (corner 3 to 4)"),
        ([polygon(*CORNERS, (50, 50))], "has the corner (50, 50) twice, as corners 3 and 5: give each corner once"),
        ([SQUARE, disc(0, 48, 5, density=-1)], "shape 2 is a hole from y = 43 to 53 mm: the wood is from -50 to 50 mm"),
    ):
        answer = client.post("/v1/phantoms", json={"name": "nothing", "shapes": shapes})
        assert refusal(answer) == (422, "invalid-request")
        assert reported in answer.json()["detail"]


def test_a_picture_is_kept_as_it_came_and_traced_by_a_job_and_the_one_offered_is_the_l_shape(client, store, woken):
    accepted = client.post("/v1/phantoms/pictures?name=ell&width_mm=400", content=PICTURE)
    assert (accepted.status_code, accepted.headers["Retry-After"]) == (202, "1")
    phantom = client.get(accepted.headers["Location"]).json()
    assert (phantom["state"], phantom["drawing"], woken) == ("tracing", None, [phantom["job_id"]])
    assert (store.files.folder / "uploads/phantoms" / phantom["id"] / "original").read_bytes() == PICTURE
    answer = client.get(f"{accepted.headers['Location']}/drawing.svg")
    assert refusal(answer) == (409, "phantom-without-drawing")
    assert "is tracing and has no drawing" in answer.json()["detail"]
    shown, fine = np.asarray(Image.open(io.BytesIO(PICTURE)), dtype=float) / 255, 8
    drawn = Image.new("L", (400 * fine, 400 * fine))
    outline = BUILT_IN_PHANTOMS["l-shape"].shapes[0].vertices_mm
    ImageDraw.Draw(drawn).polygon([((y + 200) * fine, (x + 200) * fine) for x, y in outline], fill=255)
    expected = np.asarray(drawn.resize((400, 400), Image.Resampling.BOX), dtype=float) / 255
    assert shown.shape == (400, 400)
    assert np.abs(shown - expected).mean() < 0.002


def polygon(*corners, **more):
    return {"kind": "polygon", "vertices_mm": [list(corner) for corner in corners], **more}


def disc(x, y, radius_mm, **more):
    return {"kind": "disc", "center_mm": [x, y], "radius_mm": radius_mm, **more}


CORNERS = ((-50, -50), (50, -50), (50, 50), (-50, 50))
SQUARE, LINE = polygon(*CORNERS), polygon((0, 0), (0, 50), (0, 100))
BOW = polygon((-50, -50), (50, 50), (50, -60), (-50, 50))


def test_a_phantom_measured_anew_is_another_one_that_follows_it_and_no_day_to_come_is_taken(client):
    length = {"dimension": "x", "measured_mm": 199.9, "standard_uncertainty_mm": 0.05}
    made = client.post("/v1/phantoms/l-shape/measurements", json={"measurements": [length]})
    assert made.status_code == 201
    newer = client.get(made.headers["Location"]).json()
    assert (newer["built_in"], newer["drawing"]["follows"]) == (False, "l-shape")
    assert client.get("/v1/phantoms/l-shape").json()["drawing"]["measurements"] == []
    refused = client.post("/v1/phantoms/l-shape/measurements", json={"measurements": [length | {"measured_mm": 20}]})
    assert refusal(refused) == (422, "measurement-of-another-phantom")
    length["measured_on"] = "2999-12-25"
    drawing = {"name": "board", "shapes": [polygon((-100, -50), (100, -50), (100, 50))], "measurements": [length]}
    for path, body in (("/l-shape/measurements", {"measurements": [length]}), ("", drawing)):
        refused = client.post(f"/v1/phantoms{path}", json=body)
        assert refused.status_code == 422
        assert "measured_on 2999-12-25 of x is still to come" in refused.json()["detail"]


def drawn(store, *measurements: SizeMeasurement) -> str:
    return store.phantoms.create(
        PhantomDrawing(name="<round>", shapes=[Disc(center_mm=(0, 0), radius_mm=50)], measurements=list(measurements))
    ).id


def measured(days_ago: int, expires_in_days: int | None, axis: str = "x") -> SizeMeasurement:
    today = date.today()  # noqa: DTZ011 - as people count days
    return SizeMeasurement(
        dimension=axis,
        measured_mm=100.0,
        standard_uncertainty_mm=0.1,
        instrument="caliper 12",
        measured_on=today - timedelta(days=days_ago),
        expires_on=None if expires_in_days is None else today + timedelta(days=expires_in_days),
    )


def test_the_list_says_how_well_each_size_is_known(client, store):
    for measurement, word, sentence in (
        (None, "Not measured", "Its size is as it was drawn: measure its sides."),
        (measured(425, -1), "Measure again", "Measured 14 months ago by caliper 12: measure it again."),
        (measured(60, 20), "Measure soon", "Measured 2 months ago by caliper 12. Measure it again by"),
        (measured(0, 200), "Measured", "Measured today by caliper 12, good until"),
        (measured(-1, 200), "Measured", "Measured on "),
        (measured(3, None), "Measured", "Measured 3 days ago by caliper 12, with no day on which to repeat it."),
    ):
        drawn(store, *([measurement, measurement.model_copy(update={"dimension": "y"})] if measurement else []))
        text = text_of(client.get("/phantoms").text)
        first = text[text.index("&lt;round&gt;") :]
        assert first.startswith(f"&lt;round&gt; {word} 100.0 \N{MULTIPLICATION SIGN} 100.0 mm Size known to")
        assert sentence in first
        assert text.count("built in") == 2
        assert "As published" in text


def test_a_phantom_measured_anew_takes_the_place_of_the_old_one_and_a_side_that_was_not_is_as_drawn(client, store):
    shown = text_of(client.get(f"/phantoms/{drawn(store, measured(0, 200, 'y'))}").text)
    assert "Measured along y only" in shown
    assert "Measured today by caliper 12, along y only: along x it is as it was drawn. Measure that side too." in shown
    before, length = drawn(store), {"dimension": "x", "measured_mm": 99.0, "standard_uncertainty_mm": 0.05}
    newer = client.post(f"/v1/phantoms/{before}/measurements", json={"measurements": [length]}).json()["id"]
    listed = client.get("/phantoms").text
    assert f"/phantoms/{newer}" in listed
    assert f"/phantoms/{before}" not in listed
    assert f'href="/phantoms/{newer}"' in client.get(f"/phantoms/{before}").text
    assert f'href="/phantoms/{before}"' in client.get(f"/phantoms/{newer}").text


def test_a_preview_draws_what_it_can_and_names_the_shape_that_is_wrong(client):
    shown = client.post("/phantoms/preview", json={"shapes": [SQUARE, BOW, {"kind": "disc", "center_mm": [0, None]}]})
    faults = {fault["shape"]: fault["sentence"] for fault in shown.json()["faults"]}
    assert "shape 2 is a polygon that crosses itself: side 1" in faults[1]
    assert faults[2].startswith("center_mm.1 ")
    assert shown.json()["svg"].count('class="wood wrong"') == 1
    assert client.post("/phantoms/preview", json={"shapes": [SQUARE]}).json()["faults"] == []
    assert client.post("/phantoms/preview", json={"shapes": []}).json() == {"svg": None, "faults": []}
    for lax in ("50", True):
        shown = client.post("/phantoms/preview", json={"shapes": [disc(0, 0, lax)]}).json()
        assert shown["svg"] is None
        assert shown["faults"][0]["sentence"].startswith("radius_mm should be a valid number, not")
    found = client.post("/phantoms/preview", json={"shapes": [SQUARE, disc(0, 0, 80, density=-1)]}).json()["faults"]
    assert [fault["shape"] for fault in found] == [1, None]


def test_a_traced_picture_is_shown_under_its_outline_and_what_is_none_is_refused_with_its_sentence(
    client, worker, store
):
    accepted = client.post("/v1/phantoms/pictures?name=ell&width_mm=400", content=PICTURE).json()
    page = f"/phantoms/{accepted['id']}"
    assert "The outline is being traced" in client.get(page).text
    assert "Being traced" in client.get("/phantoms").text
    worker.finish_tracing()
    traced = client.get(page).text
    assert absent(traced, "Does the outline follow the wood?", 'viewBox="-200.0 -200.0 400.0 400.0"') == []
    assert client.get(f"{page}/picture.png").content == PICTURE
    assert client.get(f"{page}/outline.svg").headers["Content-Type"] == "image/svg+xml"
    accepted = client.post("/v1/phantoms/pictures?name=ell&width_mm=400", content=b"no picture").json()
    store.jobs.request_cancel(accepted["job_id"])
    page = client.get(f"/phantoms/{accepted['id']}").text
    assert absent(page, "The picture could not be traced", "its job was cancelled before it ended") == []


def test_a_plan_is_held_against_tolerances_and_a_built_in_phantom_stays_offered_beside_one_that_was_measured(seeded):
    page = text_of(seeded.get("/phantoms/l-shape").text)
    assert absent(page, "Are the rays right?", "In 95 of 100 cases the rays are off by less than 0.0") == []
    assert "Are the millimetres right?" in page
    assert text_of(seeded.get("/phantoms/l-shape/plans").text).strip().startswith("Line &lt;2&gt;, 20 views")
    refused = seeded.post("/phantoms/l-shape/delete")
    assert refused.status_code == 409
    assert "is built in and stays" in text_of(refused.text.replace("&#39;", "'"))
    assert seeded.post("/phantoms/example-spare/delete").headers["Location"] == "/phantoms"
    assert seeded.get("/phantoms/example-spare").status_code == 404
    length = {"dimension": "x", "measured_mm": 199.9, "standard_uncertainty_mm": 0.05}
    newer = seeded.post("/v1/phantoms/l-shape/measurements", json={"measurements": [length]}).json()["id"]
    listed, asked = seeded.get("/phantoms").text, seeded.get("/calibrate?scan=example").text
    for phantom_id in ("l-shape", newer):
        assert f'href="/phantoms/{phantom_id}"' in listed
        assert f'name="phantom_id" value="{phantom_id}"' in asked
    # Both have the same name.
    assert asked.count('<span class="soft">built in</span>') == 2
