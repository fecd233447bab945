"""The volume as arrays and thumbnails, and lists by span of time."""

import io
import math
from datetime import UTC, datetime, timedelta

import nrrd
import numpy as np
import pytest
import tifffile
from PIL import Image

from sawmill_formats.output.volume_exports import tiff_header
from sawmill_formats.output.volume_reader import VolumeGrid
from sawmill_vocabulary import ColorMap
from sawmill_worker.pictures.arrays import averaged
from sawmill_worker.pictures.windows import painted

LOG = "/v1/reconstructions/example"


def loaded(answer) -> np.ndarray:
    assert answer.status_code == 200, answer.text
    return np.load(io.BytesIO(answer.content), allow_pickle=False)


def test_a_slice_is_the_volume_s_own_values(seeded, volume):
    answer = seeded.get(f"{LOG}/slices/1.npy")
    np.testing.assert_array_equal(loaded(answer), volume[1])
    given = {name: answer.headers[name] for name in ("X-Pixel-Mm", "X-First-Pixel-Mm", "X-Height-Mm", "X-Unit")}
    # 32 pixels of 1.25 mm around the rotation centre; slices 20 mm apart.
    assert given == {
        "X-Pixel-Mm": "1.25",
        "X-First-Pixel-Mm": "-19.375,-19.375",
        "X-Height-Mm": "20.0",
        "X-Unit": "1/mm",
    }
    assert answer.headers["Content-Disposition"] == 'attachment; filename="reconstruction-example-slice-1.npy"'
    assert int(answer.headers["Content-Length"]) == len(answer.content)


@pytest.mark.parametrize(("max_size", "factor"), [(16, 2), (31, 2), (32, 1), (512, 1)])
def test_a_large_slice_is_averaged_over_whole_pixels(seeded, volume, max_size, factor):
    answer = seeded.get(f"{LOG}/slices/0.npy?max_size={max_size}")
    side = 32 // factor
    expected = volume[0].reshape(side, factor, side, factor).mean(axis=(1, 3))
    np.testing.assert_allclose(loaded(answer), expected, atol=1e-6)  # float32, in another order
    assert float(answer.headers["X-Pixel-Mm"]) == 1.25 * factor
    # The first edge of the field stays where it is.
    assert float(answer.headers["X-First-Pixel-Mm"].partition(",")[0]) - 0.5 * 1.25 * factor == pytest.approx(-20.0)


@pytest.mark.parametrize(("color_map", "mode"), [("grey", "L"), ("viridis", "RGB")])
def test_a_slice_in_few_bytes_is_near_the_exact_one(seeded, volume, color_map, mode):
    low, high = float(volume[1].min()) - 0.5, float(volume[1].max()) + 0.5
    window = f"window_low={low}&window_high={high}&color_map={color_map}"
    drawn = Image.open(io.BytesIO(seeded.get(f"{LOG}/slices/1.jpg?{window}&max_size=16").content))
    assert (drawn.format, drawn.mode, drawn.size) == ("JPEG", mode, (16, 16))
    exact = painted((averaged(volume[1], 2) - low) / (high - low), ColorMap(color_map))
    # The volume is smooth. Halved colours of its steep map differ more than its greys.
    np.testing.assert_allclose(np.asarray(drawn, float), exact, atol=6 if mode == "L" else 24)


def test_a_block_at_the_edge_is_the_mean_of_what_is_there():
    image = np.arange(15.0).reshape(3, 5)
    np.testing.assert_allclose(averaged(image, 2), [[3.0, 5.0, 6.5], [10.5, 12.5, 14.0]])


def test_the_side_view_is_the_densest_along_an_axis(seeded, volume):
    np.testing.assert_array_equal(loaded(seeded.get(f"{LOG}/side.npy")), volume.max(axis=1))
    np.testing.assert_array_equal(loaded(seeded.get(f"{LOG}/side.npy?along=y")), volume.max(axis=2))


def test_a_volume_is_read_back_from_the_files_of_other_programs(seeded, volume, tmp_path):
    for suffix in ("tif", "nrrd"):
        answer = seeded.get(f"{LOG}/volume.{suffix}")
        assert answer.headers["Content-Disposition"] == f'attachment; filename="reconstruction-example.{suffix}"'
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


def test_a_stack_beyond_the_reach_of_a_tiff_s_offsets_is_found_by_its_description(tmp_path):
    shape = (100, 4096, 4096)
    grid = VolumeGrid(shape, 0.1, (-204.75, -204.75), None, None)
    header = tiff_header(grid, "1/mm")
    with (tmp_path / "volume.tif").open("wb") as file:
        file.write(header)
        file.truncate(len(header) + 4 * math.prod(shape))  # a hole, which takes no disk
    with tifffile.TiffFile(tmp_path / "volume.tif") as stack:
        assert (len(stack.pages), stack.series[0].shape) == (1, shape)


def test_a_thumbnail_is_drawn_once_with_the_axes_of_the_slices_and_kept(seeded, store):
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


def test_the_colour_maps_are_those_of_the_pictures(seeded):
    maps = seeded.get("/v1/color-maps").json()
    assert {name: len(colors) for name, colors in maps.items()} == dict.fromkeys(
        ("grey", "viridis", "inferno", "magma"), 256
    )
    assert (maps["grey"][7], maps["viridis"][0]) == ([7, 7, 7], [68, 1, 84])


@pytest.mark.parametrize("kind", ["scans", "reconstructions"])
def test_a_list_may_be_of_a_span_of_time(seeded, kind):
    everything = seeded.get(f"/v1/{kind}").json()["items"]
    newest, oldest = everything[0]["created_at"], everything[-1]["created_at"]

    def listed(**query: str) -> list[str]:
        return [item["id"] for item in seeded.get(f"/v1/{kind}", params=query).json()["items"]]

    assert listed(created_from=oldest) == [item["id"] for item in everything]
    assert listed(created_from=newest) == [everything[0]["id"]]
    assert everything[0]["id"] not in listed(created_before=newest)
    later = (datetime.now(UTC) + timedelta(days=1)).isoformat()
    assert listed(created_from=later, scanner_id="example") == []
    assert seeded.get(f"/v1/{kind}?created_from=2026-03-01T00:00:00").status_code == 422  # no offset
