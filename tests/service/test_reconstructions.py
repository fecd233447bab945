"""Reconstructions as pictures, arrays, thumbnails and files of other programs."""

import io
import math
from datetime import UTC, datetime, timedelta

import h5py
import nrrd
import numpy as np
import pytest
import tifffile
from asgi import refusal
from PIL import Image
from results import THETA, written_by_its_job

from sawmill_calibration.pictures.images import averaged
from sawmill_calibration.pictures.pages import painted
from sawmill_formats.output.volume_exports import tiff_header
from sawmill_formats.output.volume_reader import VolumeGrid
from sawmill_vocabulary import ColorMap


def test_what_contradicts_itself_is_refused_and_a_theta_of_ones_own_needs_no_calibration(seeded):
    answer = seeded.post("/v1/reconstructions", json={"scan_id": "example", "theta": THETA, "rotation": "reversed"})
    assert answer.json()["calibration_id"] is None
    answer = seeded.post("/v1/calibrations", json={"scan_id": "example", "rows": "0:9:2"})
    assert "rows that are averaged must be A:B, without a step, not '0:9:2'" in answer.json()["detail"]
    answer = seeded.get("/v1/reconstructions/example/slices/0.png?bits=16&color_map=viridis")
    assert "bits=16 holds values, in grey; for color_map=viridis ask for bits=8" in answer.json()["detail"]


OWN_THETA = [
    ("detector_shift_mm", 1e300, "should be less than or equal to 100000, not 1e+300"),
    ("source_shift_mm", -1e6, "should be greater than or equal to -100000, not -1000000"),
    ("detector_to_cor_mm", -700.0, "should be greater than 0, not -700"),
    ("detector_tilt", 11.0, "should be less than or equal to 10, not 11"),
    ("initial_angle_rad", 1e9, "should be less than or equal to 1000, not 1000000000"),
]


def test_a_geometry_or_a_field_that_cannot_be_is_refused_with_a_sentence(seeded):
    for options, reported in (
        *(({"theta": THETA | {name: value}}, f"body.theta.{name} {words}") for name, value, words in OWN_THETA),
        ({"theta": THETA, "calibration_id": "example"}, "body is refused: give calibration_id or theta, not both"),
        ({"alpha": 1.0}, "alpha belongs to method tikhonov, not auto"),
        ({"size": [256, 128]}, "size must be one number, since pixels are square, not [256, 128]"),
        ({"field_mm": [400, 300.5]}, "field_mm must be one number, since pixels are square, not [400, 300.5]"),
        ({"field_centre_mm": [1e6, 0]}, "field_centre_mm"),
        ({"rows": "0:9:0"}, "rows must be A:B with 0 <= A < B, as in 0:16, or A:B:STEP"),
    ):
        answer = seeded.post("/v1/reconstructions", json={"scan_id": "example", **options})
        assert refusal(answer) == (422, "invalid-request")
        assert reported in answer.json()["detail"]
        if "theta" in options and "calibration_id" not in options:
            plan = seeded.post("/v1/phantoms/l-shape/plans", json={"scanner_id": "example", **options})
            assert plan.json()["detail"] == reported


def test_slices_and_windows_are_distinguished_and_sixteen_bits_hold_the_values(seeded, volume):
    answer = seeded.get("/v1/reconstructions/example/slices/1.png?bits=16&window_low=0&window_high=4")
    drawn = np.asarray(Image.open(io.BytesIO(answer.content)))
    assert drawn.shape == (32, 32)
    np.testing.assert_allclose(drawn / 65535 * 4, volume[1], atol=1e-4)
    urls = [
        f"slices/{index}.png?window_high={high}&bits={bits}" for index in (0, 1) for high in (2, 3) for bits in (8, 16)
    ]
    answers = [seeded.get(f"/v1/reconstructions/example/{url}") for url in urls]
    assert {answer.status_code for answer in answers} == {200}
    assert len({answer.headers["ETag"] for answer in answers}) == len(urls)


def drawn(answer) -> Image.Image:
    assert answer.status_code == 200, answer.text
    return Image.open(io.BytesIO(answer.content))


def test_a_slice_has_the_colours_the_scale_bar_and_the_deviation_that_were_asked_for(seeded):
    path = "/v1/reconstructions/example/slices/0.png"
    plain, bare, colored = (
        drawn(seeded.get(f"{path}?{query}")) for query in ("", "scale_bar=false", "color_map=viridis")
    )
    assert (plain.mode, colored.mode) == ("L", "RGB")
    assert np.count_nonzero(np.asarray(plain) != np.asarray(bare)) > 100
    assert (68, 1, 84) in dict(map(reversed, colored.getcolors(2**24)))  # where viridis begins
    shown = seeded.get("/v1/reconstructions/example-sparse/slices/1.png", params={"show": "deviation", "bits": 16})
    with Image.open(io.BytesIO(shown.content)) as image:
        # A tenth of the slice, whose values rise from 0 to 2.
        assert float(image.text["window_high"]) == pytest.approx(0.2, rel=0.05)
    refused = seeded.get("/v1/reconstructions/example/slices/1.png", params={"show": "deviation"})
    assert refusal(refused) == (409, "no-deviation")


def test_a_mosaic_shows_the_slices_asked_for(seeded):
    for query, columns in {"": 2, "count=1": 1, "slices=0:2": 2, "slices=0:3:3": 1, "count=64": 2}.items():
        width, height = drawn(seeded.get(f"/v1/reconstructions/example/mosaic.png?{query}")).size
        # Tiles of 256 pixels, the colour bar and margins beside them.
        assert 256 * columns < width < 256 * columns + 256, query
        assert height > 256, query


def test_the_side_views_are_what_the_axes_show(seeded):
    along_x, along_y = (
        np.asarray(drawn(seeded.get(f"/v1/reconstructions/example/side.png?along={axis}&window_low=0&window_high=3")))
        for axis in "xy"
    )
    # Along x each slice is as dense as it ever is, slices 1, 2, 3; along y it is a ramp down to the densest line.
    assert {85, 170, 255} <= set(along_x[along_x.shape[0] // 2].tolist())
    first, last = (along_y[row, 150] for row in (60, 250))
    assert first < last


def test_marks_are_kept_with_the_log_and_change_one_by_one(seeded):
    ruler = {"kind": "ruler", "slice": 1, "ends_mm": [[0.0, -5.0], [3.0, 4.0]], "note": "knot"}
    for name in ("first", "second", "first"):
        marked = seeded.put(f"{LOG}/marks/{name}", json=ruler | {"note": None if name == "first" else "knot"})
    assert seeded.get(LOG).json()["marks"] == marked.json()["marks"]
    assert [(mark["id"], mark["note"]) for mark in marked.json()["marks"]] == [("first", None), ("second", "knot")]
    assert [seeded.delete(f"{LOG}/marks/second").status_code for _ in range(2)] == [204, 204]
    audit = [entry for entry in seeded.get("/v1/audit").json()["items"] if entry["action"] == "reconstruction-marked"]
    assert [list(entry["detail"]) for entry in audit] == [["second"], ["second"], ["first"]]
    assert refusal(seeded.put(f"{LOG}/marks/third", json=ruler | {"slice": 3})) == (404, "slice-not-found")
    for name in range(2, 102):
        full = seeded.put(f"{LOG}/marks/{name}", json=ruler)
    assert refusal(full) == (409, "too-many-marks")


@pytest.mark.slow
def test_how_alpha_was_chosen_is_drawn_where_it_was(seeded):
    assert drawn(seeded.get("/v1/reconstructions/example-sparse/alpha-curve.png")).width > 800
    assert refusal(seeded.get("/v1/reconstructions/example/alpha-curve.png")) == (409, "no-alpha-curve")


LOG = "/v1/reconstructions/example"


def loaded(answer) -> np.ndarray:
    assert answer.status_code == 200, answer.text
    return np.load(io.BytesIO(answer.content), allow_pickle=False)


def test_a_slice_or_a_side_view_is_the_volume_s_own_values_averaged_where_it_is_large(seeded, volume):
    answer = seeded.get(f"{LOG}/slices/1.npy")
    np.testing.assert_array_equal(loaded(answer), volume[1])
    given = {name: answer.headers[name] for name in ("X-Pixel-Mm", "X-First-Pixel-Mm", "X-Height-Mm", "X-Unit")}
    # 32 pixels of 1.25 mm around the rotation centre; slices 20 mm apart.
    assert list(given.values()) == ["1.25", "-19.375,-19.375", "20.0", "1/mm"]
    assert answer.headers["Content-Disposition"] == 'attachment; filename="Line -2--1, slice 1.npy"'
    assert int(answer.headers["Content-Length"]) == len(answer.content)
    for max_size, factor in ((16, 2), (31, 2), (32, 1), (512, 1)):
        answer, side = seeded.get(f"{LOG}/slices/0.npy?max_size={max_size}"), 32 // factor
        expected = volume[0].reshape(side, factor, side, factor).mean(axis=(1, 3))
        np.testing.assert_allclose(loaded(answer), expected, atol=1e-6)  # float32, in another order
        assert float(answer.headers["X-Pixel-Mm"]) == 1.25 * factor
        # The first edge of the field stays where it is.
        assert float(answer.headers["X-First-Pixel-Mm"].partition(",")[0]) - 0.5 * 1.25 * factor == pytest.approx(-20.0)
    # A block at the edge is the mean of what is there.
    np.testing.assert_allclose(averaged(np.arange(15.0).reshape(3, 5), 2), [[3.0, 5.0, 6.5], [10.5, 12.5, 14.0]])
    np.testing.assert_array_equal(loaded(seeded.get(f"{LOG}/side.npy")), volume.max(axis=1))
    np.testing.assert_array_equal(loaded(seeded.get(f"{LOG}/side.npy?along=y")), volume.max(axis=2))
    maps = seeded.get("/v1/color-maps").json()
    assert {name: len(colors) for name, colors in maps.items()} == dict.fromkeys(
        ("grey", "viridis", "inferno", "magma"), 256
    )
    assert (maps["grey"][7], maps["viridis"][0]) == ([7, 7, 7], [68, 1, 84])


def test_a_slice_in_few_bytes_is_near_the_exact_one(seeded, volume):
    for color_map, mode in (("grey", "L"), ("viridis", "RGB")):
        low, high = float(volume[1].min()) - 0.5, float(volume[1].max()) + 0.5
        window = f"window_low={low}&window_high={high}&color_map={color_map}"
        drawn = Image.open(io.BytesIO(seeded.get(f"{LOG}/slices/1.jpg?{window}&max_size=16").content))
        assert (drawn.format, drawn.mode, drawn.size) == ("JPEG", mode, (16, 16))
        exact = painted((averaged(volume[1], 2) - low) / (high - low), ColorMap(color_map))
        # The volume is smooth. Halved colours of its steep map differ more than its greys.
        np.testing.assert_allclose(np.asarray(drawn, float), exact, atol=6 if mode == "L" else 24)


def test_a_volume_is_read_back_from_the_files_of_other_programs_however_large(seeded, volume, tmp_path):
    seeded.put(f"{LOG}/name", json={"name": 'Mänty 14: "tyvi"'})
    for suffix in ("tif", "nrrd"):
        answer = seeded.get(f"{LOG}/volume.{suffix}")
        named = f"filename=\"Manty 14- -tyvi-.{suffix}\"; filename*=UTF-8''M%C3%A4nty%2014-%20-tyvi-.{suffix}"
        assert answer.headers["Content-Disposition"] == f"attachment; {named}"
        assert int(answer.headers["Content-Length"]) == len(answer.content)
        (tmp_path / f"volume.{suffix}").write_bytes(answer.content)
    # 32 pixels of 1.25 mm around the rotation centre; slices 20 mm apart.
    with tifffile.TiffFile(tmp_path / "volume.tif") as stack:
        assert stack.is_imagej
        assert (len(stack.pages), stack.series[0].axes) == (3, "ZYX")
        np.testing.assert_array_equal(stack.asarray(), volume)
        given = stack.imagej_metadata
        assert (given["unit"], given["spacing"], given["xorigin"], given["zorigin"]) == ("mm", 20.0, 15.5, 0.0)
        across, per_mm = stack.pages[0].tags["XResolution"].value
        assert across / per_mm == pytest.approx(1 / 1.25)
    with Image.open(tmp_path / "volume.tif") as pages:  # a reader that goes by the pages alone
        pages.seek(2)
        np.testing.assert_array_equal(np.asarray(pages), volume[2])
    values, header = nrrd.read(str(tmp_path / "volume.nrrd"), index_order="C")
    np.testing.assert_array_equal(values, volume)
    # From the fastest axis on: y, x, and along the log.
    np.testing.assert_array_equal(header["space directions"], [[0, 1.25, 0], [1.25, 0, 0], [0, 0, 20.0]])
    np.testing.assert_array_equal(header["space origin"], [-19.375, -19.375, 0.0])
    assert header["space units"] == ["mm", "mm", "mm"]
    shape = (100, 4096, 4096)
    header = tiff_header(VolumeGrid(shape, 0.1, (-204.75, -204.75), None, None), "1/mm")
    with (tmp_path / "volume.tif").open("wb") as file:
        file.write(header)
        file.truncate(len(header) + 4 * math.prod(shape))  # a hole, which takes no disk
    with tifffile.TiffFile(tmp_path / "volume.tif") as stack:
        assert (len(stack.pages), stack.series[0].shape) == (1, shape)


def test_a_thumbnail_is_drawn_once_and_a_volume_without_side_views_or_removed_is_a_problem(seeded, store):
    drawn = np.asarray(Image.open(io.BytesIO(seeded.get(f"{LOG}/thumbnail.png").content))).astype(int)
    # The volume rises along x, which runs down the picture.
    assert (drawn[-1] > drawn[0]).all()
    assert (drawn[:, 0] == drawn[:, -1]).all()
    for path, kept in (("reconstructions/example", "reconstructions/example"), ("scans/example", "scans/example")):
        answer = seeded.get(f"/v1/{path}/thumbnail.png")
        assert Image.open(io.BytesIO(answer.content)).size == (160, 160)
        file = store.files.folder / kept / "thumbnail.png"
        assert file.read_bytes() == answer.content
        file.write_bytes(b"kept")
        assert seeded.get(f"/v1/{path}/thumbnail.png").content == b"kept"
    with h5py.File(store.files.volume("example"), "r+") as file:
        del file["entry/side_view"]
    written_by_its_job(store, store.files.folder / "reconstructions/example/volume.h5")
    answer = seeded.get("/v1/reconstructions/example/side.png")
    assert refusal(answer) == (409, "no-side-view")
    assert "reconstruct the scan again" in answer.json()["detail"]
    store.files.volume("example").unlink()
    for name in ("volume.h5", "slices/0.png", "mosaic.png", "side.png"):
        answer = seeded.get(f"/v1/reconstructions/example/{name}")
        assert (answer.status_code, answer.headers["Content-Type"]) == (404, "application/problem+json")


def test_a_list_may_be_of_a_span_of_time(seeded):
    for kind in ("scans", "reconstructions"):
        everything = seeded.get(f"/v1/{kind}").json()["items"]
        newest, oldest = everything[0]["created_at"], everything[-1]["created_at"]

        def listed(kind: str = kind, **query: str) -> list[str]:
            return [item["id"] for item in seeded.get(f"/v1/{kind}", params=query).json()["items"]]

        assert listed(created_from=oldest) == [item["id"] for item in everything]
        assert listed(created_from=newest) == [everything[0]["id"]]
        assert everything[0]["id"] not in listed(created_before=newest)
        assert listed(created_from=(datetime.now(UTC) + timedelta(days=1)).isoformat(), scanner_id="example") == []
        assert seeded.get(f"/v1/{kind}?created_from=2026-03-01T00:00:00").status_code == 422  # no offset
