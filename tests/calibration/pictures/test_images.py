"""Images, mosaics and side views of a log, and the drawing of a phantom: what stands where, and how large."""

import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from io import BytesIO

import numpy as np
import pytest
from matplotlib import colormaps
from PIL import Image

from sawmill_calibration.pictures.images import image_png, image_png16, sinogram_png
from sawmill_calibration.pictures.log_pictures import TILE_PX, mosaic_png, side_view_png, spread
from sawmill_calibration.pictures.pages import painted, window_of
from sawmill_calibration.pictures.phantom_drawing import phantom_svg
from sawmill_calibration.pictures.round_numbers import round_length, ticks
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_vocabulary import ColorMap, Disc, Polygon
from sawmill_vocabulary.side_view import SideView

PLACE = {"pixel_mm": 0.5, "first_pixel_mm": (60.25, -40.0)}


@pytest.fixture
def rng():
    return np.random.default_rng(20261120)


def decoded(png):
    return Image.open(BytesIO(png))


def panel_of(png, side):
    """The left upper part of the picture's panel: it begins inside the first long lines of its frame."""
    page = np.asarray(decoded(png))
    frame = page == 120
    left = np.flatnonzero(frame.sum(axis=0) > 500)[0] + 1
    top = np.flatnonzero(frame.sum(axis=1) > 500)[0] + 1
    return page[top : top + side, left : left + side]


def test_row_is_x_and_column_is_y():
    image = np.zeros((256, 256))
    image[10, 200] = 1.0
    panel = panel_of(image_png(image, pixel_mm=None, unit="1", window=(0, 1)), 512)
    assert np.argwhere(panel == 255).tolist() == [[20, 400], [20, 401], [21, 400], [21, 401]]


def test_small_images_are_enlarged_by_whole_factors(rng):
    png = image_png(rng.random((100, 130)), pixel_mm=2.0, unit="1/mm", title="row 3")
    assert decoded(png).mode == "L"
    assert min(decoded(png).size) >= 512
    panel = panel_of(png, 600)
    np.testing.assert_array_equal(panel[::6, ::6][:, :100], panel[5::6, 5::6][:, :100])


def test_scale_bar_has_the_length_on_its_label(rng):
    page = np.asarray(decoded(image_png(rng.random((256, 256)), pixel_mm=400 / 256, unit="1/mm", window=(-1, 0))))
    assert max(int(np.argmax(row != 20)) for row in page[530:, 15:]) == 128  # 100 mm at 400 mm over 512 pixels


@pytest.mark.parametrize("side", [256, 2048])
def test_the_longest_unit_stands_whole_on_the_page(side):
    page = np.asarray(decoded(image_png(np.zeros((side, side)), pixel_mm=None, unit="line integral/mm", window=(0, 1))))
    right_of_the_bar = page[page.shape[0] // 4 : page.shape[0] * 3 // 4, page.shape[1] * 19 // 20 :]
    assert (right_of_the_bar < 255).any()
    assert (right_of_the_bar[:, -3:] == 255).all()


def test_colours_are_those_of_the_map():
    image = np.array([[0.0, 1.0], [2.0, 3.0]])
    page = decoded(image_png(image, pixel_mm=None, unit="1", window=(0, 3), color_map=ColorMap.INFERNO))
    assert page.mode == "RGB"
    seen = {color for _, color in page.getcolors(maxcolors=10_000)}
    assert {tuple(color) for color in painted(np.array([0.0, 1 / 3, 2 / 3, 1.0]), ColorMap.INFERNO).tolist()} <= seen


@pytest.mark.parametrize("name", [name for name in ColorMap if name is not ColorMap.GREY])
def test_colour_maps_are_the_published_ones(name):
    ours = painted(np.linspace(0, 1, 256), name)
    published = colormaps[name](np.arange(256))[:, :3] * 255
    # Rounded to 8 bits.
    assert np.abs(ours - published).max() < 1.0


def test_a_window_clips_and_a_constant_image_has_a_picture():
    panel = panel_of(image_png(np.array([[-5.0, 0.0], [1.0, 9.0]]), pixel_mm=None, unit="1", window=(0, 1)), 512)
    assert [panel[0, 0], panel[0, -1], panel[-1, 0], panel[-1, -1]] == [0, 0, 255, 255]
    assert decoded(image_png(np.ones((16, 16)), pixel_mm=1.0, unit="1")).size[0] > 512


def test_16_bit_gives_the_values_back(rng):
    image = rng.normal(size=(30, 40))
    png = decoded(image_png16(image, **PLACE))
    assert (png.text["pixel_mm"], png.text["first_pixel_mm"]) == ("0.5", "60.25,-40.0")
    low, high = float(png.text["window_low"]), float(png.text["window_high"])
    assert (low, high) == (image.min(), image.max())
    grey = np.asarray(png)
    assert grey.dtype == np.uint16
    np.testing.assert_allclose(low + grey / 65535 * (high - low), image, atol=(high - low) / 65535 / 1.99)


def test_16_bit_takes_a_window(rng):
    assert np.asarray(decoded(image_png16(rng.random((8, 8)), window=(10.0, 20.0), **PLACE))).max() == 0


@pytest.mark.parametrize(("views", "cells"), [(360, 768), (20, 768), (3, 5)])
def test_sinogram_shows_views_downwards(views, cells):
    sinogram = np.zeros((views, cells))
    sinogram[0] = 1.0
    png = sinogram_png(sinogram, angles_deg=np.arange(views) * 1.0, pitch_mm=1.5, unit="1")
    assert min(decoded(png).size) > 512
    assert (panel_of(png, 500)[0] == 255).all()
    assert (panel_of(png, 500)[-1] == 0).all()


def test_wrong_use_is_a_sentence():
    with pytest.raises(ValueError, match=r"two-dimensional image, not one of shape \(3,\)"):
        image_png(np.zeros(3), pixel_mm=None, unit="1")
    with pytest.raises(ValueError, match="not finite"):
        image_png16(np.array([[np.nan, 1.0]]), window=(0, 1), **PLACE)
    with pytest.raises(ValueError, match="low < high"):
        image_png16(np.zeros((2, 2)), window=(1, 1), **PLACE)
    with pytest.raises(ValueError, match="3 views needs as many angles, not 2"):
        sinogram_png(np.zeros((3, 4)), angles_deg=np.zeros(2), pitch_mm=1.0, unit="1")


@pytest.mark.parametrize(("longest", "length"), [(133.0, 100), (99.9, 50), (50, 50), (0.3, 0.2), (10, 10)])
def test_round_length(longest, length):
    assert round_length(longest) == pytest.approx(length)


@pytest.mark.parametrize(("low", "high"), [(-577.1, 577.1), (0, 1), (-0.03, 0.07), (3, 3000)])
def test_ticks_are_round_few_and_inside(low, high):
    values = ticks(low, high)
    assert 2 <= len(values) <= 6
    assert low <= values[0] < values[-1] <= high


def test_window_leaves_outliers_out(rng):
    values = rng.random((100, 100))
    values[0, 0] = 1e6
    assert window_of(values)[1] < 1.1


def test_a_grey_slice_is_drawn_without_matplotlib():
    program = (
        "import sys, numpy; from sawmill_calibration.pictures import images, log_pictures; "
        "images.image_png(numpy.eye(8), pixel_mm=1.0, unit='1/mm'); "
        "ours = ('matplotlib', 'sawmill_calibration', 'sawmill_service'); "
        "print(sorted(m for m in sys.modules if m.split('.')[0] in ours and '.vocabulary' not in m))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == str(
        [
            "sawmill_calibration",
            "sawmill_calibration.pictures",
            "sawmill_calibration.pictures.images",
            "sawmill_calibration.pictures.log_pictures",
            "sawmill_calibration.pictures.pages",
            "sawmill_calibration.pictures.round_numbers",
        ]
    )


def marked(size, row, column):
    image = np.zeros((size, size), np.float32)
    image[row, column] = 1.0
    return image


def mosaic(images, **options):
    slices = ((image, f"slice {n}") for n, image in enumerate(images))
    return np.asarray(
        decoded(mosaic_png(slices, **{"pixel_mm": 400 / len(images[0]), "unit": "1/mm", "window": (0, 1)} | options))
    )


def tiles_of(page):
    """The left upper corners of the black squares."""
    black = page == 0
    corners = black & ~np.roll(black, 1, axis=0) & ~np.roll(black, 1, axis=1)
    return [
        (int(top), int(left)) for top, left in np.argwhere(corners) if black[top : top + 40, left : left + 40].all()
    ]


@pytest.mark.parametrize(("count", "available", "expected"), [(1, 9, [4]), (3, 9, [1, 4, 7]), (4, 3, [0, 1, 2])])
def test_slices_are_spread_over_the_log(count, available, expected):
    assert spread(count, available) == expected


def test_slices_stand_in_reading_order():
    greys = (50, 100, 150, 200, 230)
    page = mosaic([np.full((64, 64), grey / 255, np.float32) for grey in greys], pixel_mm=None)
    shown = [page == grey for grey in greys]
    # Text and the colour bar have a few pixels of each grey.
    tops = [int(np.flatnonzero(pixels.sum(axis=1) >= TILE_PX)[0]) for pixels in shown]
    lefts = [int(np.flatnonzero(pixels.sum(axis=0) >= TILE_PX)[0]) for pixels in shown]
    assert tops[0] == tops[1] == tops[2] < tops[3] == tops[4]
    assert lefts[0] == lefts[3] < lefts[1] == lefts[4] < lefts[2]
    assert tops[3] - tops[0] > TILE_PX


@pytest.mark.parametrize(("size", "side"), [(128, 256), (100, 300), (256, 256)])
def test_small_slices_are_enlarged_by_whole_factors_and_row_is_x(size, side):
    page = mosaic([marked(size, size // 4, size - 1)])
    ((top, left),) = tiles_of(page)
    bright = np.argwhere(page[top : top + side, left : left + side] == 255)
    factor = side // size
    assert (len(bright), bright.min(axis=0).tolist()) == (factor**2, [size // 4 * factor, side - factor])


def test_large_slices_are_averaged():
    image = np.zeros((1024, 1024), np.float32)
    image[256:260, 512:516] = 1.0
    image[256, 512] = 0.0
    page = mosaic([image])
    ((top, left),) = tiles_of(page)
    tile = page[top : top + TILE_PX, left : left + TILE_PX]
    assert np.argwhere(tile).tolist() == [[64, 128]]
    assert tile[64, 128] == round(255 * 15 / 16)


def test_the_scale_bar_of_a_mosaic_is_that_of_a_tile():
    page = mosaic([np.zeros((100, 100), np.float32)] * 2)
    # 100 mm of 400 mm over 300 pixels.
    assert max(int(np.argmax(row != 20)) for row in page[340:, 15:]) == 75
    assert (mosaic([np.zeros((100, 100), np.float32)] * 2, pixel_mm=None)[360:, :80] == 255).all()


@pytest.mark.parametrize("size", [129, 255, 256, 300])
def test_the_scale_bar_of_a_lone_slice_stands_clear_of_the_orientation(size):
    # 400 mm: the bar is the longest there is, a quarter.
    below = mosaic([np.ones((size, size), np.float32)])[-36:]
    # The bar and its length are darker than the orientation; letters have soft edges, two pixels wide.
    end = int(np.flatnonzero((below < 100).any(axis=0)).max()) + 3
    assert (below[:, end : end + 5] == 255).all()
    assert (below[:, end + 5 :] < 255).any()


def test_a_mosaic_can_have_colours_and_a_title():
    images = [marked(32, 3, 4)] * 3
    assert mosaic(images, color_map=ColorMap.VIRIDIS).shape[2] == 3
    assert mosaic(images, title="log.h5").shape[0] > mosaic(images).shape[0]


def test_a_mosaic_and_a_side_view_of_what_is_none_are_a_sentence():
    with pytest.raises(ValueError, match="at least one slice"):
        mosaic_png([], pixel_mm=1.0, unit="1", window=(0, 1))
    with pytest.raises(ValueError, match=r"square slices, not one of shape \(3, 4\)"):
        mosaic([np.zeros((3, 4))])
    with pytest.raises(ValueError, match=r"two-dimensional, not of shape \(4,\)"):
        side_view(np.zeros(4))
    with pytest.raises(ValueError, match="not finite"):
        side_view(np.full((3, 4), np.nan))


def side_view(densest, along_mm=None):
    view = SideView(densest, "y", (-200.0, 200.0), along_mm, "1/mm")
    return np.asarray(decoded(side_view_png(view, window=(0, 1))))


def framed(page):
    frame = page == 120
    lefts, tops = np.flatnonzero(frame.sum(axis=0) > 190), np.flatnonzero(frame.sum(axis=1) > 190)
    return page[tops[0] + 1 : tops[-1], lefts[0] + 1 : lefts[1]]


def test_the_log_runs_to_the_right_true_to_scale():
    densest = np.zeros((50, 128), np.float32)
    densest[40, 32] = 1.0
    panel = framed(side_view(densest, along_mm=(-20.0, 1980.0)))
    assert panel.shape == (256, 1280)
    bright = np.argwhere(panel == 255)
    assert (bright.min(axis=0).tolist(), bright.max(axis=0).tolist()) == ([64, 1024], [65, 1049])


def test_what_is_densest_stays_in_sight_in_long_logs():
    densest = np.zeros((9_001, 1024), np.float32)
    densest[7_777, 333] = 1.0
    panel = framed(side_view(densest))
    assert panel.shape == (512, 4096)
    bright = np.argwhere(panel == 255)
    assert set(bright[:, 0].tolist()) == {333 // 2}
    # Three slices are one column.
    assert bright[:, 1].mean() == pytest.approx(7_777 / 9_001 * 4096, abs=3)


def test_a_single_slice_is_wide_enough_to_see():
    assert framed(side_view(np.ones((1, 64), np.float32), along_mm=(-1.0, 1.0))).shape == (256, 192)


SVG = "{http://www.w3.org/2000/svg}"


BOARD = Polygon(vertices_mm=[(-100.0, -150.0), (100.0, -150.0), (100.0, 150.25), (-100.0, 150.25)])


def disc(x_mm: float, y_mm: float, radius_mm: float, density: float = 1.0) -> Disc:
    return Disc(center_mm=(x_mm, y_mm), radius_mm=radius_mm, density=density)


HOLE = disc(-50.0, -49.0, 26.0, -1.0)


def drawn(name: str, *shapes: Polygon | Disc) -> ET.Element:
    return ET.fromstring(phantom_svg(PhantomDrawing(name=name, shapes=shapes)))  # noqa: S314 - our own text


def outline(root: ET.Element) -> list[tuple[float, float]]:
    """The first polygon's corners on the paper, (right, down)."""
    return [tuple(map(float, point.split(","))) for point in root.find(f"{SVG}polygon").get("points").split()]


def words(root: ET.Element) -> list[str]:
    return [element.text for element in root.iter(f"{SVG}text")]


def test_a_unit_is_a_millimetre_on_paper_down_is_x_and_right_is_y():
    root = drawn("board", BOARD)
    assert re.fullmatch(r"0 0 ([\d.]+) ([\d.]+) \1mm \2mm", " ".join(map(root.get, ("viewBox", "width", "height"))))
    corners = outline(drawn("board", BOARD))
    across, down = corners[0]
    expected = [(across + y + 150.0, down + x + 100.0) for x, y in BOARD.vertices_mm]
    assert sum(corners, ()) == pytest.approx(sum(expected, ()))


def test_a_hole_is_cut_into_the_wood_whatever_the_order():
    for shapes in ((BOARD, HOLE), (HOLE, BOARD)):
        root = drawn("board", *shapes)
        wood, hole = [element for element in root if element.tag in {f"{SVG}polygon", f"{SVG}circle"}][:2]
        assert wood.get("fill") != hole.get("fill") == "#fff"
        across, down = outline(root)[0]
        assert float(hole.get("r")) == 26.0
        assert (float(hole.get("cx")), float(hole.get("cy"))) == pytest.approx((across + 101.0, down + 50.0))


def test_sizes_name_and_scale_are_written_and_the_bar_is_a_hundred_millimetres():
    assert {"300.25", "200", "board", "100 mm", "⌀ 52 at (-50, -49)"} <= set(words(drawn("board", BOARD, HOLE)))
    thickest = max(drawn("board", BOARD).iter(f"{SVG}line"), key=lambda line: float(line.get("stroke-width")))
    assert float(thickest.get("x2")) - float(thickest.get("x1")) == pytest.approx(100.0)


def test_everything_lies_on_the_paper_the_rotation_centre_too():
    root = drawn("beside", disc(60.0, 90.0, 20.0), disc(-300.0, 40.0, 5.0, -1.0))
    width, height = (float(root.get(name).removesuffix("mm")) for name in ("width", "height"))
    (mark,) = [circle for circle in root.iter(f"{SVG}circle") if circle.get("fill") == "none"]
    assert 0.0 < float(mark.get("cx")) < width
    assert 0.0 < float(mark.get("cy")) < height
    assert {"40"} <= set(words(root))


@pytest.mark.parametrize("name", ["a <b> & 'c'", "bell\x07", "none\ufffe"])
def test_any_name_makes_valid_xml(name):
    assert drawn(name, BOARD).findtext(f"{SVG}title") == "".join(letter for letter in name if letter.isprintable())
