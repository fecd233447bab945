"""Image quality from a disc: sharpness and noise that theory gives for this aperture, filter and pixel."""

import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry, GeometryError, Scanner
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.reconstruction.image_quality import image_quality
from sawmill_vocabulary import Disc, FilterName, Theta

SCANNER, THETA = Scanner(859.46, 768, 1.502864583), Theta(2.55, 714.7, 319.9, 43.7, 0.281)
GEOMETRY = FanBeamGeometry(SCANNER, THETA, 2.0 * np.pi * (np.arange(720) + 0.5) / 720)
CELL_MM = SCANNER.detector_pitch_mm / GEOMETRY.frame.magnification
WINDOWS = {"hann": lambda f: 0.5 + 0.5 * np.cos(np.pi * f), "cosine": lambda f: np.cos(0.5 * np.pi * f)}


def slice_of(*shapes, name="hann", scaling=1.0, pixels=512, noise=0.0):
    rays = simulate_sinogram(Phantom("body", shapes), GEOMETRY, noise=noise, seed=56)
    projector = Projector(GEOMETRY, ImageGrid(pixels, 200.0))
    image = fbp(projector, rays, filter_name=FilterName(name), frequency_scaling=scaling).image
    return np.asarray(image)[np.newaxis], noise * np.sqrt(np.mean(rays**2))


def disc(radius_mm, centre_mm=(3.3, -2.1), density=1.0):
    return Disc(center_mm=centre_mm, radius_mm=radius_mm, density=density)


def transfer(f, name, scaling, pixel_mm, cell_mm):
    """Of the product's FBP: window, linear interpolation of rays, and the mean over a pixel's shadow."""
    relative = 2.0 * f * cell_mm / scaling
    return np.where(relative < 1.0, WINDOWS[name](relative), 0.0) * np.sinc(f * cell_mm) ** 2 * np.sinc(f * pixel_mm)


@pytest.mark.parametrize(
    ("name", "scaling", "pixels", "radius_mm"),
    [("hann", 1.0, 512, 80.0), ("hann", 1.0, 256, 40.0), ("hann", 0.5, 512, 60.0), ("cosine", 1.0, 512, 80.0)],
)
def test_the_mtf_falls_to_a_tenth_where_aperture_filter_and_pixel_say(name, scaling, pixels, radius_mm):
    volume, _ = slice_of(disc(radius_mm), name=name, scaling=scaling, pixels=pixels)
    quality = image_quality(volume, 200.0 / pixels)
    # A ray that touches the rim leaves the source at asin(r / R), and meets a flat detector aslant.
    aslant = np.sqrt(1.0 - (radius_mm / GEOMETRY.frame.source_distance_mm) ** 2) ** 3
    f = np.linspace(0.0, 1.5, 15_001)
    expected = np.sinc(f * CELL_MM * aslant) * transfer(f * aslant, name, scaling, 200.0 / pixels, CELL_MM)
    assert quality.mtf_10_per_mm == pytest.approx(f[np.argmax(expected < 0.1)], rel=0.02)
    assert quality.radius_mm == pytest.approx(radius_mm, abs=0.05)
    listed = np.array(quality.frequencies_per_mm)
    used = listed < 0.9 * quality.mtf_10_per_mm
    assert np.array(quality.mtf)[used] == pytest.approx(np.interp(listed, f, expected)[used], abs=0.02)


@pytest.mark.parametrize(("name", "pixels"), [("hann", 512), ("cosine", 256)])
def test_the_contrast_of_patches_is_that_of_filtered_noise(name, pixels):
    pixel_mm = 200.0 / pixels
    volume, deviation = slice_of(disc(80.0), name=name, pixels=pixels, noise=0.01)
    quality = image_quality(volume, pixel_mm)
    f, df = np.linspace(1e-6, 0.5 / CELL_MM, 2000, retstep=True)
    angles = np.pi * (np.arange(180) + 0.5) / 360
    for side in (1, 2, 4):
        along, across = (
            np.sinc(side * f[:, np.newaxis] * pixel_mm * axis) / np.sinc(f[:, np.newaxis] * pixel_mm * axis)
            for axis in (np.cos(angles), np.sin(angles))
        )
        power = f**2 * transfer(f, name, 1.0, pixel_mm, CELL_MM) ** 2 * np.mean((along * across) ** 2, axis=1)
        variance = np.pi**2 / 720 * deviation**2 * CELL_MM * 2.0 * np.sum(power) * df
        assert quality.patch_mm[side - 1] == pytest.approx(side * pixel_mm)
        assert quality.contrast_percent[side - 1] == pytest.approx(300.0 * np.sqrt(variance), rel=0.05)


def test_a_bowl_and_several_slices_change_neither():
    volume, _ = slice_of(disc(80.0, (0.0, 0.0)), pixels=256, noise=0.01)
    x, y = np.indices(volume.shape[1:]) - 127.5
    bowl = 0.3 * (x**2 + y**2) / 100.0**2 * slice_of(disc(80.0, (0.0, 0.0)), pixels=256)[0]
    plain, bowled = image_quality(volume, 1.0), image_quality(np.concatenate([volume, volume]) + bowl, 1.0)
    assert bowled.mtf_10_per_mm == pytest.approx(plain.mtf_10_per_mm, rel=0.02)
    level = bowled.contrast_percent[0] / plain.contrast_percent[0]
    assert level == pytest.approx(1.0 / (1.0 + 0.3 * 0.107), rel=0.02), "the same noise, of a little more density"
    assert np.array(bowled.contrast_percent) / plain.contrast_percent == pytest.approx(level, rel=0.02)


@pytest.mark.parametrize(
    "shapes",
    [L_SHAPE.shapes, (disc(60.0), disc(5.0, (20.0, 0.0), -1.0)), (disc(60.0), disc(20.0, (60.0, 0.0))), (disc(6.0),)],
)
def test_what_is_no_plain_disc_is_refused(shapes):
    volume, _ = slice_of(*shapes, pixels=256)
    with pytest.raises(GeometryError, match=r"no plain disc is seen .* cannot calibrate"):
        image_quality(volume, 200.0 / 256)


def test_air_and_pixels_that_are_too_large_for_the_scan_are_refused():
    with pytest.raises(GeometryError, match="no plain disc is seen"):
        image_quality(np.zeros((1, 128, 128), np.float32), 1.0)
    x, y = np.indices((128, 128)) - 63.5
    with pytest.raises(GeometryError, match="too large for this MTF"):
        image_quality((np.hypot(x, y) < 40.0)[np.newaxis].astype(np.float32), 1.0)
