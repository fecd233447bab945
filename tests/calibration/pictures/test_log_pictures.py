"""A mosaic shows each slice once, where its label stands; a side view shows what is densest, where it is."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from sawmill_calibration.pictures.log_pictures import TILE_PX, mosaic_png, side_view_png, spread
from sawmill_vocabulary import ColorMap

FIELD = (-200.0, 200.0)


def decoded(png):
    return np.asarray(Image.open(BytesIO(png)))


def marked(size, row, column):
    """An image that is bright in one pixel."""
    image = np.zeros((size, size), np.float32)
    image[row, column] = 1.0
    return image


def mosaic(images, **options):
    slices = ((image, f"slice {n}") for n, image in enumerate(images))
    return decoded(mosaic_png(slices, **{"pixel_mm": 400 / len(images[0]), "unit": "1/mm", "window": (0, 1)} | options))


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
    assert len(bright) == factor**2
    assert bright.min(axis=0).tolist() == [size // 4 * factor, side - factor]


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
    page = mosaic([np.ones((size, size), np.float32)])
    below = page[-36:]
    # The bar and its length are darker than the orientation; letters have soft edges, two pixels wide.
    end = int(np.flatnonzero((below < 100).any(axis=0)).max()) + 3
    assert (below[:, end : end + 5] == 255).all()
    assert (below[:, end + 5 :] < 255).any()


def test_a_mosaic_can_have_colours_and_a_title():
    images = [marked(32, 3, 4)] * 3
    assert mosaic(images, color_map=ColorMap.VIRIDIS).shape[2] == 3
    assert mosaic(images, title="log.h5").shape[0] > mosaic(images).shape[0]


def test_a_mosaic_of_nothing_or_of_no_squares_is_a_sentence():
    with pytest.raises(ValueError, match="at least one slice"):
        mosaic_png([], pixel_mm=1.0, unit="1", window=(0, 1))
    with pytest.raises(ValueError, match=r"square slices, not one of shape \(3, 4\)"):
        mosaic([np.zeros((3, 4))])


def side_view(densest, **options):
    given = {"across_mm": FIELD, "across": "y", "along_mm": None, "unit": "1/mm", "window": (0, 1)}
    return decoded(side_view_png(densest, **given | options))


def framed(page):
    """The panel inside its frame."""
    frame = page == 120
    lefts, tops = np.flatnonzero(frame.sum(axis=0) > 190), np.flatnonzero(frame.sum(axis=1) > 190)
    return page[tops[0] + 1 : tops[-1], lefts[0] + 1 : lefts[1]]


def test_the_log_runs_to_the_right_true_to_scale():
    densest = np.zeros((50, 128), np.float32)
    densest[40, 32] = 1.0
    panel = framed(side_view(densest, along_mm=(-20.0, 1980.0)))
    assert panel.shape == (256, 1280)
    bright = np.argwhere(panel == 255)
    assert bright.min(axis=0).tolist() == [64, 1024]
    assert bright.max(axis=0).tolist() == [65, 1049]


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


def test_a_side_view_of_what_is_none_is_a_sentence():
    with pytest.raises(ValueError, match=r"two-dimensional, not of shape \(4,\)"):
        side_view(np.zeros(4))
    with pytest.raises(ValueError, match="not finite"):
        side_view(np.full((3, 4), np.nan))
