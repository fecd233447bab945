"""Nails in a log: what becomes of its slices by every method."""

import numpy as np
import pytest
from small_scanner import reconstruction_input

from sawmill_calibration.reconstruction.reconstruct import reconstruct_in_memory
from sawmill_contracts.reconstructions import ReconstructionOptions
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Scanner, Theta
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.simulate import simulate_rows
from sawmill_tomography.reconstruction import metal
from sawmill_vocabulary.image_messages import ImageMessage

MILL = Scanner(source_to_cor_mm=859.46, num_detector_pixels=160, detector_pitch_mm=3.0)
THETA = Theta(0.7, 715.0, 40.0, 10.0, 0.05)
WOOD = Phantom("log", (Disc((5.0, -4.0), 90.0, 0.018), Disc((15.0, 20.0), 20.0, 0.012)))
NAILED = Phantom("nailed", (*WOOD.shapes, Disc((40.0, 10.0), 3.0, 0.3), Disc((-30.0, -45.0), 2.5, 0.3)))
SIZE, FIELD_MM, VIEWS = 48, 240.0, 30
X, Y = np.meshgrid(*2 * [np.linspace(-117.5, 117.5, SIZE)], indexing="ij")
# Outside the metal and the pixels beside it.
AWAY = np.all([np.hypot(X - n.center_mm[0], Y - n.center_mm[1]) > 9.0 for n in NAILED.shapes[2:]], axis=0)


def images(bodies, **options):
    fan = FanBeamGeometry(MILL, THETA, (np.arange(VIEWS) + 0.5) * TAU / VIEWS)
    given = reconstruction_input(simulate_rows(bodies, fan, noise=0.01, seed=5), fan)
    asked = ReconstructionOptions(size=SIZE, field_mm=FIELD_MM, **options)
    made = reconstruct_in_memory(given, given.geometry, asked, lambda _: None)
    return made.data, made.result.method


def error(image):
    truth = WOOD.rasterise(SIZE, FIELD_MM)
    return float(np.linalg.norm((image - truth)[AWAY]) / np.linalg.norm(truth[AWAY]))


@pytest.mark.parametrize("method", ["fbp", "tikhonov"])
def test_interpolated_rays_leave_no_streaks(method):
    (nailed, plain), report = images([NAILED, WOOD], method=method)
    as_it_is, untreated = images([NAILED], method=method, metal="none")
    # The wood behind the nails is interpolated: a tenth of the error without nails.
    assert error(nailed) < 1.1 * error(plain) < 0.7 * error(as_it_is[0])
    assert (report.metal.slices, report.metal.treatment) == (1, "interpolated")
    assert "Kalender" in report.metal.source
    assert 0.0 < report.metal.share_of_samples < 0.15
    assert untreated.metal is None
    # Steel is 17 times the wood, and a nail fills a third of its pixels.
    assert nailed[~AWAY].max() > 3.0 * plain.max()


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("total_variation", {"weight": 300.0}),
        ("cauchy_map", {"sigma": 0.03, "beta": 0.004}),
        pytest.param("total_variation", {}, marks=pytest.mark.slow),
        pytest.param("cauchy_map", {}, marks=pytest.mark.slow),
    ],
)
def test_rays_are_left_out_by_methods_that_can_do_without(method, options):
    (nailed,), report = images([NAILED], method=method, **options)
    (plain,), _ = images([WOOD], method=method, **options)
    assert error(nailed) < 1.3 * error(plain)
    assert (report.metal.slices, report.metal.treatment) == (1, "left-out")
    # Left in, these rays alone would make it many times as large.
    assert report.data_misfit < 1.6
    assert nailed[~AWAY].max() > 3.0 * plain.max()


def test_rays_can_be_interpolated_for_every_method():
    _, report = images([NAILED], method="total_variation", weight=300.0, metal="interpolate")
    assert report.metal.treatment == "interpolated"


@pytest.mark.parametrize("method", ["fbp", "tikhonov"])
def test_a_log_without_metal_is_what_it_was(method):
    found, report = images([WOOD], method=method)
    assert np.array_equal(found, images([WOOD], method=method, metal="none")[0])
    assert report.metal is None


def test_a_slice_full_of_metal_is_left_as_it_is(monkeypatch):
    monkeypatch.setattr(metal, "MOST_SAMPLES", 0.01)
    found, report = images([NAILED, WOOD], method="fbp")
    assert np.array_equal(found, images([NAILED, WOOD], method="fbp", metal="none")[0])
    assert (report.metal.slices, report.metal.untreated_slices, report.metal.share_of_samples) == (0, 1, 0.0)
    (remark,) = report.coded_remarks
    assert remark.code == ImageMessage.METAL_LEFT
