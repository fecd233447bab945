import subprocess
import sys
from io import BytesIO

import numpy as np
import pytest
from matplotlib import colormaps
from PIL import Image

from sawmill_calibration.pictures.images import image_png, image_png16, sinogram_png
from sawmill_calibration.pictures.round_numbers import round_length, ticks
from sawmill_calibration.pictures.windows import painted, window_of
from sawmill_vocabulary import ColorMap

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
    image = rng.random((100, 130))
    png = image_png(image, pixel_mm=2.0, unit="1/mm", title="row 3")
    assert decoded(png).mode == "L"
    assert min(decoded(png).size) >= 512
    panel = panel_of(png, 600)
    np.testing.assert_array_equal(panel[::6, ::6][:, :100], panel[5::6, 5::6][:, :100])


def test_scale_bar_has_the_length_on_its_label(rng):
    page = np.asarray(decoded(image_png(rng.random((256, 256)), pixel_mm=400 / 256, unit="1/mm", window=(-1, 0))))
    bar = max(int(np.argmax(row != 20)) for row in page[530:, 15:])
    assert bar == 128  # 100 mm at 400 mm over 512 pixels


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
    assert {painted_color(fraction, "inferno") for fraction in (0.0, 1 / 3, 2 / 3, 1.0)} <= seen


def painted_color(fraction, name):
    return tuple(painted(np.array(fraction), ColorMap(name)).tolist())


@pytest.mark.parametrize("name", [name for name in ColorMap if name is not ColorMap.GREY])
def test_colour_maps_are_the_published_ones(name):
    ours = painted(np.linspace(0, 1, 256), name)
    published = colormaps[name](np.arange(256))[:, :3] * 255
    # Rounded to 8 bits.
    assert np.abs(ours - published).max() < 1.0


def test_window_clips():
    image = np.array([[-5.0, 0.0], [1.0, 9.0]])
    panel = panel_of(image_png(image, pixel_mm=None, unit="1", window=(0, 1)), 512)
    assert [panel[0, 0], panel[0, -1], panel[-1, 0], panel[-1, -1]] == [0, 0, 255, 255]


def test_constant_image_has_a_picture():
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
    grey = np.asarray(decoded(image_png16(rng.random((8, 8)), window=(10.0, 20.0), **PLACE)))
    assert grey.max() == 0


@pytest.mark.parametrize(("views", "cells"), [(360, 768), (20, 768), (3, 5)])
def test_sinogram_shows_views_downwards(views, cells):
    sinogram = np.zeros((views, cells))
    sinogram[0] = 1.0
    png = sinogram_png(sinogram, angles_deg=np.arange(views) * 1.0, pitch_mm=1.5, unit="1")
    width, height = decoded(png).size
    assert width > 512
    assert height > 512
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
    drawing = ("images", "log_pictures", "pages", "round_numbers", "windows")
    pictures = "sawmill_calibration.pictures"
    assert done.stdout.strip() == str(["sawmill_calibration", pictures, *(f"{pictures}.{name}" for name in drawing)])
