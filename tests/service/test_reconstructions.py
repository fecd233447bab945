import io

import h5py
import numpy as np
import pytest
from asgi import refusal
from damaged_files import written_by_its_job
from PIL import Image
from results import THETA

from sawmill_contracts.reconstructions import ReconstructionAsked


def test_a_theta_of_ones_own_needs_no_calibration(seeded):
    answer = seeded.post("/v1/reconstructions", json={"scan_id": "example", "theta": THETA, "rotation": "reversed"})
    assert answer.json()["calibration_id"] is None


OWN_THETA = [
    ("detector_shift_mm", 1e300, "should be less than or equal to 100000, not 1e+300"),
    ("source_shift_mm", -1e6, "should be greater than or equal to -100000, not -1000000"),
    ("detector_to_cor_mm", -700.0, "should be greater than 0, not -700"),
    ("detector_tilt", 11.0, "should be less than or equal to 10, not 11"),
    ("initial_angle_rad", 1e9, "should be less than or equal to 1000, not 1000000000"),
]


@pytest.mark.parametrize(
    ("options", "reported"),
    [
        *(({"theta": THETA | {name: value}}, f"body.theta.{name} {words}") for name, value, words in OWN_THETA),
        ({"theta": THETA, "calibration_id": "example"}, "body is refused: give calibration_id or theta, not both"),
        ({"alpha": 1.0}, "alpha belongs to method tikhonov, not auto"),
        ({"size": [256, 128]}, "size must be one number, since pixels are square, not [256, 128]"),
        ({"field_mm": [400, 300.5]}, "field_mm must be one number, since pixels are square, not [400, 300.5]"),
        ({"field_centre_mm": [1e6, 0]}, "field_centre_mm"),
        ({"rows": "0:9:0"}, "rows must be A:B with 0 <= A < B, as in 0:16, or A:B:STEP"),
    ],
)
def test_a_geometry_or_a_field_that_cannot_be_is_refused_with_a_sentence(seeded, options, reported):
    answer = seeded.post("/v1/reconstructions", json={"scan_id": "example", **options})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid-request")
    assert reported in answer.json()["detail"]
    if "theta" in options and "calibration_id" not in options:
        plan = seeded.post("/v1/phantoms/l-shape/plans", json={"scanner_id": "example", **options})
        assert plan.json()["detail"] == reported


def test_a_theta_that_an_earlier_version_accepted_is_still_listed(seeded, store):
    ask = ReconstructionAsked(scan_id="example", theta={**THETA, "detector_shift_mm": 1e300})
    kept = store.reconstructions.accept(ask)
    assert seeded.get(f"/v1/reconstructions/{kept.id}").json()["options"]["theta"]["detector_shift_mm"] == 1e300


def test_what_contradicts_itself_is_refused_with_a_sentence(seeded):
    answer = seeded.post("/v1/calibrations", json={"scan_id": "example", "rows": "0:9:2"})
    assert "rows that are averaged must be A:B, without a step, not '0:9:2'" in answer.json()["detail"]
    answer = seeded.get("/v1/reconstructions/example/slices/0.png?bits=16&color_map=viridis")
    assert "bits=16 holds values, in grey; for color_map=viridis ask for bits=8" in answer.json()["detail"]


def test_a_sixteen_bit_slice_holds_the_values_of_its_window(seeded, volume):
    answer = seeded.get("/v1/reconstructions/example/slices/1.png?bits=16&window_low=0&window_high=4")
    drawn = np.asarray(Image.open(io.BytesIO(answer.content)))
    assert drawn.shape == (32, 32)
    np.testing.assert_allclose(drawn / 65535 * 4, volume[1], atol=1e-4)


def test_slices_and_windows_are_distinguished(seeded):
    urls = [
        f"slices/{index}.png?window_high={high}&bits={bits}" for index in (0, 1) for high in (2, 3) for bits in (8, 16)
    ]
    answers = [seeded.get(f"/v1/reconstructions/example/{url}") for url in urls]
    assert {answer.status_code for answer in answers} == {200}
    assert len({answer.headers["ETag"] for answer in answers}) == len(urls)


def drawn(answer) -> Image.Image:
    assert answer.status_code == 200, answer.text
    return Image.open(io.BytesIO(answer.content))


def test_a_slice_has_the_colours_and_the_scale_bar_that_were_asked_for(seeded):
    path = "/v1/reconstructions/example/slices/0.png"
    plain, bare, colored = (
        drawn(seeded.get(f"{path}?{query}")) for query in ("", "scale_bar=false", "color_map=viridis")
    )
    assert (plain.mode, colored.mode) == ("L", "RGB")
    assert np.count_nonzero(np.asarray(plain) != np.asarray(bare)) > 100
    assert (68, 1, 84) in colored.get_flattened_data()  # where viridis begins


@pytest.mark.parametrize(
    ("query", "columns"), [("", 2), ("count=1", 1), ("slices=0:2", 2), ("slices=0:3:3", 1), ("count=64", 2)]
)
def test_a_mosaic_shows_the_slices_asked_for(seeded, query, columns):
    width, height = drawn(seeded.get(f"/v1/reconstructions/example/mosaic.png?{query}")).size
    # Tiles of 256 pixels, the colour bar and margins beside them.
    assert 256 * columns < width < 256 * columns + 256
    assert height > 256


def test_the_side_views_are_what_the_axes_show(seeded):
    along_x, along_y = (
        np.asarray(drawn(seeded.get(f"/v1/reconstructions/example/side.png?along={axis}&window_low=0&window_high=3")))
        for axis in "xy"
    )
    # Along x each slice is as dense as it ever is, slices 1, 2, 3; along y it is a ramp down to the densest line.
    assert {85, 170, 255} <= set(along_x[along_x.shape[0] // 2].tolist())
    first, last = (along_y[row, 150] for row in (60, 250))
    assert first < last


def test_each_pixel_s_deviation_is_drawn_in_its_own_window(seeded):
    url = "/v1/reconstructions/example-sparse/slices/1.png"
    shown = seeded.get(url, params={"show": "deviation", "bits": 16})
    with Image.open(io.BytesIO(shown.content)) as image:
        # A tenth of the slice, whose values rise from 0 to 2.
        assert float(image.text["window_high"]) == pytest.approx(0.2, rel=0.05)
    refused = seeded.get("/v1/reconstructions/example/slices/1.png", params={"show": "deviation"})
    assert (refused.status_code, refused.json()["code"]) == (409, "no-deviation")


@pytest.mark.slow
def test_how_alpha_was_chosen_is_drawn_where_it_was(seeded):
    assert drawn(seeded.get("/v1/reconstructions/example-sparse/alpha-curve.png")).width > 800
    assert refusal(seeded.get("/v1/reconstructions/example/alpha-curve.png")) == (409, "no-alpha-curve")


def test_a_volume_without_side_views_or_removed_by_hand_is_a_problem(seeded, store):
    with h5py.File(store.files.volume("example"), "r+") as file:
        del file["entry/side_view"]
    written_by_its_job(store, store.files.folder / "reconstructions/example/volume.h5")
    answer = seeded.get("/v1/reconstructions/example/side.png")
    assert (answer.status_code, answer.json()["code"]) == (409, "no-side-view")
    assert "reconstruct the scan again" in answer.json()["detail"]
    store.files.volume("example").unlink()
    for name in ("volume.h5", "slices/0.png", "mosaic.png", "side.png"):
        answer = seeded.get(f"/v1/reconstructions/example/{name}")
        assert (answer.status_code, answer.headers["Content-Type"]) == (404, "application/problem+json")
