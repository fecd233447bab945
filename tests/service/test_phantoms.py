import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

import sawmill_service
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS, PhantomDrawing

PICTURE = (Path(sawmill_service.__file__).parent / "static/phantom.png").read_bytes()


def test_the_built_in_ones_are_there_and_stay(client):
    for phantom_id in ("l-shape", "rectangle-with-hole"):
        assert client.get(f"/v1/phantoms/{phantom_id}").json()["state"] == "ready"
        assert client.delete(f"/v1/phantoms/{phantom_id}").json()["code"] == "phantom-built-in"


def test_a_drawn_phantom_is_ready_at_once(client):
    drawing = {"name": "disc", "shapes": [{"kind": "disc", "center_mm": [0, 0], "radius_mm": 50}]}
    created = client.post("/v1/phantoms", json=drawing)
    assert created.status_code == 201
    assert client.get(created.headers["Location"]).json()["drawing"]["shapes"][0]["radius_mm"] == 50


def test_a_picture_is_kept_as_it_came_and_traced_by_a_job(client, store, woken):
    accepted = client.post("/v1/phantoms/pictures?name=ell&width_mm=400", content=PICTURE)
    assert accepted.status_code == 202
    assert accepted.headers["Retry-After"] == "1"
    phantom = client.get(accepted.headers["Location"]).json()
    assert (phantom["state"], phantom["drawing"]) == ("tracing", None)
    assert woken == [phantom["job_id"]]
    kept = store.files.folder / "uploads/phantoms" / phantom["id"] / "original"
    assert kept.read_bytes() == PICTURE


@pytest.mark.parametrize("query", ["name=ell", "name=ell&width_mm=-1", "name=&width_mm=400"])
def test_a_picture_needs_a_name_and_a_positive_width(client, query):
    assert client.post(f"/v1/phantoms/pictures?{query}", content=PICTURE).status_code == 422


def test_a_picture_may_not_be_larger_than_the_limit(client, settings):
    answer = client.post("/v1/phantoms/pictures?name=ell&width_mm=400", content=bytes(settings.max_picture_bytes + 1))
    assert answer.status_code == 413


def test_the_picture_offered_to_try_is_the_l_shape():
    shown = np.asarray(Image.open(io.BytesIO(PICTURE)), dtype=float) / 255
    fine = 8
    drawn = Image.new("L", (400 * fine, 400 * fine))
    outline = BUILT_IN_PHANTOMS["l-shape"].shapes[0].vertices_mm
    ImageDraw.Draw(drawn).polygon([((y + 200) * fine, (x + 200) * fine) for x, y in outline], fill=255)
    expected = np.asarray(drawn.resize((400, 400), Image.Resampling.BOX), dtype=float) / 255
    assert shown.shape == (400, 400)
    assert np.abs(shown - expected).mean() < 0.002


def test_a_drawing_is_svg_for_those_who_do_not_hold_it(client):
    answer = client.get("/v1/phantoms/rectangle-with-hole/drawing.svg")
    assert (answer.status_code, answer.headers["Content-Type"]) == (200, "image/svg+xml")
    assert "⌀ 52 at (-50, -49)" in answer.text
    assert 'width="360.36mm"' in answer.text
    again = client.get(
        "/v1/phantoms/rectangle-with-hole/drawing.svg", headers={"If-None-Match": answer.headers["ETag"]}
    )
    assert (again.status_code, again.content) == (304, b"")
    other = client.get("/v1/phantoms/l-shape/drawing.svg")
    assert other.headers["ETag"] != answer.headers["ETag"]


def test_a_phantom_that_is_being_traced_has_no_drawing(client):
    accepted = client.post("/v1/phantoms/pictures?name=ell&width_mm=400", content=PICTURE)
    answer = client.get(f"{accepted.headers['Location']}/drawing.svg")
    assert (answer.status_code, answer.json()["code"]) == (409, "phantom-without-drawing")
    assert "is tracing and has no drawing" in answer.json()["detail"]


SQUARE = {"kind": "polygon", "vertices_mm": [[-50, -50], [50, -50], [50, 50], [-50, 50]]}


@pytest.mark.parametrize(
    ("shapes", "reported"),
    [
        (
            [{"kind": "polygon", "vertices_mm": [[0, 0], [0, 50], [0, 100]]}],
            "shape 1 is a polygon that encloses 0 mm²",
        ),
        (
            [SQUARE, {"kind": "polygon", "vertices_mm": [[1, 1], [1, 1], [1, 1]]}],
            "shape 2 is a polygon that encloses 0",
        ),
        (
            [{"kind": "disc", "center_mm": [100, 0], "radius_mm": 1e-300}],
            "is a disc of radius 1e-300 mm: give at least 0.1 mm",
        ),
        ([{**SQUARE, "density": 1e9}], "has density 1e+09: give one within ±1000"),
        ([SQUARE, {**SQUARE, "density": -1}], "add up to 0 mm²: wood must outweigh holes"),
        ([{**SQUARE, "density": 0}], "add up to 0 mm²"),
        ([{**SQUARE, "density": 1e-300}], "has density 1e-300: give 0 or one of at least 1e-06"),
        (
            [{"kind": "polygon", "vertices_mm": [[-50, -50], [50, 50], [50, -60], [-50, 50]]}],
            "crosses itself: side 1 (corner 1 to 2) meets side 3 (corner 3 to 4)",
        ),
        (
            [{"kind": "polygon", "vertices_mm": [*SQUARE["vertices_mm"], [50, 50]]}],
            "has the corner (50, 50) twice, as corners 3 and 5: give each corner once",
        ),
        (
            [SQUARE, {"kind": "disc", "center_mm": [0, 48], "radius_mm": 5, "density": -1}],
            "shape 2 is a hole from y = 43 to 53 mm: the wood is from -50 to 50 mm",
        ),
    ],
)
def test_a_drawing_without_extent_is_a_problem(client, shapes, reported):
    answer = client.post("/v1/phantoms", json={"name": "nothing", "shapes": shapes})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid-request")
    assert reported in answer.json()["detail"]


def test_a_drawing_without_extent_that_an_earlier_version_accepted_is_drawn(client, store):
    line = {"kind": "polygon", "vertices_mm": [[0, 0], [0, 50], [0, 100]]}
    kept = store.phantoms.create(PhantomDrawing(name="line", shapes=[line]))
    assert client.get(f"/v1/phantoms/{kept.id}").status_code == 200
    assert client.get(f"/v1/phantoms/{kept.id}/drawing.svg").status_code == 200


def test_a_polygon_that_is_closed_by_its_first_corner_is_the_same_polygon(client):
    corners = [[-100, -50], [100, -50], [100, 50], [-100, 50]]
    shape = {"kind": "polygon", "vertices_mm": [*corners, corners[0]]}
    created = client.post("/v1/phantoms", json={"name": "board", "shapes": [shape]})
    assert (created.status_code, created.json()["drawing"]["shapes"][0]["vertices_mm"]) == (201, corners)


def test_a_measurement_of_a_day_to_come_is_refused(client):
    length = {"what": "x", "measured_mm": 199.9, "standard_uncertainty_mm": 0.05, "measured_on": "2999-12-25"}
    corners = [[-100, -50], [100, -50], [100, 50], [-100, 50]]
    drawing = {"name": "board", "shapes": [{"kind": "polygon", "vertices_mm": corners}], "measurements": [length]}
    for path, body in (("/l-shape/measurements", {"measurements": [length]}), ("", drawing)):
        refused = client.post(f"/v1/phantoms{path}", json=body)
        assert refused.status_code == 422
        assert "measured_on 2999-12-25 of x is still to come" in refused.json()["detail"]


def test_a_phantom_measured_anew_is_another_one_that_follows_it(client):
    length = {"what": "x", "measured_mm": 199.9, "standard_uncertainty_mm": 0.05}
    made = client.post("/v1/phantoms/l-shape/measurements", json={"measurements": [length]})
    assert made.status_code == 201
    newer = client.get(made.headers["Location"]).json()
    assert (newer["built_in"], newer["drawing"]["follows"]) == (False, "l-shape")
    assert client.get("/v1/phantoms/l-shape").json()["drawing"]["measurements"] == []
    refused = client.post("/v1/phantoms/l-shape/measurements", json={"measurements": [length | {"measured_mm": 20}]})
    assert (refused.status_code, refused.json()["code"]) == (422, "measurement-of-another-phantom")


def test_a_drawing_cannot_say_that_it_follows_another(client):
    drawing = {"name": "disc", "shapes": [{"kind": "disc", "center_mm": [0, 0], "radius_mm": 50}]}
    refused = client.post("/v1/phantoms", json=drawing | {"follows": "l-shape"})
    assert refused.status_code == 422
    assert "body.follows must be left out, not 'l-shape'" in refused.json()["detail"]
    assert client.post("/v1/phantoms", json=drawing | {"follows": None}).status_code == 201
