"""Reconstruction by every method: the fit, the chosen parameters, the volume's file, and its blocks."""

from dataclasses import fields, replace

import h5py
import numpy as np
import pytest
from pydantic import ValidationError
from small_scanner import reconstruction_input

from sawmill_calibration import failures
from sawmill_calibration.reconstruction.reconstruct import (
    SAMPLED_VALUES,
    ValueRange,
    reconstruct_in_memory,
    run_reconstruction,
)
from sawmill_contracts.reconstructions import OptionOf, ReconstructionOptions
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_tomography.geometry.geometry import FanBeamGeometry, Theta, to_vector
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_tomography.reconstruction.choosing import METHODS
from sawmill_tomography.reconstruction.quality import relative_error

pytestmark = pytest.mark.slow

# Off the centre, with a knot: no slice of it looks like another one turned.
LOG = Phantom("log", (Disc((25.0, -10.0), 110.0, 0.018), Disc((60.0, 20.0), 20.0, 0.012)))
SIZE, FIELD_MM = 48, 400.0
TAPE = Theta(0.0, 18.0, 14.0, -11.0, -0.03)
ITERATIVE = ("tikhonov", "cauchy_map", "total_variation")


@pytest.fixture
def log(scanner, theta, turn):
    """Rows of one log with 2 % noise, and a background where wanted."""

    def of(*, views=20, rows=1, background=0.0, counts=False, noise=0.02):
        fan = FanBeamGeometry(scanner, theta, turn(views))
        line = project(LOG, DetectorCells.of(scanner), fan.frame, fan.angles_rad, rays_per_cell=8)
        deviation = noise * np.sqrt(np.mean(line**2))
        stack = line[:, None] + deviation * np.random.default_rng(731).standard_normal((views, rows, line.shape[1]))
        stack = (stack + background).astype(np.float32)
        return reconstruction_input(stack, fan, counts=counts)

    return of


@pytest.fixture
def reconstruct(tmp_path):
    def run(given, **options):
        asked = ReconstructionOptions(**{"method": "fbp", "size": SIZE, "field_mm": FIELD_MM} | options)
        path = tmp_path / "volume.h5"
        result = run_reconstruction(given, given.geometry, asked, path, lambda _: None)
        with h5py.File(path) as file:
            volume = file["entry/reconstruction/data"][()]
            file["entry/process/method"].visit(lambda _: None)
        return result, volume

    return run


# Tikhonov explains whatever it is given while there are more pixels than rays; FBP fits only many views.
@pytest.mark.parametrize(
    ("method", "views", "times"), [*((method, 60, 1.5) for method in ITERATIVE), ("fbp", 180, 1.3)]
)
def test_a_wrong_geometry_shows_in_the_misfit(log, reconstruct, theta, method, views, times):
    given = log(views=views)
    right, volume = reconstruct(given, method=method)
    assert right.method.name == method
    assert relative_error(volume[0], LOG.rasterise(SIZE, FIELD_MM)) < 0.35
    off = Theta.from_vector(to_vector(theta) + to_vector(TAPE))
    wrong, _ = reconstruct(replace(given, theta=off), method=method)
    assert wrong.method.data_misfit > times * right.method.data_misfit


def test_few_views_are_explained_better_than_filtered(log, reconstruct):
    truth = LOG.rasterise(SIZE, FIELD_MM)
    errors = {
        method: relative_error(reconstruct(log(), method=method)[1][0], truth) for method in ("fbp", "cauchy_map")
    }
    assert errors["cauchy_map"] < 0.5 * errors["fbp"]


@pytest.mark.parametrize("views", [20, 45, 90, 360])
@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_a_good_fbp_has_no_remarks(log, reconstruct, views, noise):
    """Whatever its misfit: without filtering and pixels it would be 1."""
    good, volume = reconstruct(log(views=views, noise=noise))
    assert relative_error(volume[0], LOG.rasterise(SIZE, FIELD_MM)) < 0.5
    assert good.method.data_misfit > 1.2
    assert not good.method.remarks


@pytest.mark.parametrize("views", [90, 360])
@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_fbp_reports_a_geometry_that_is_far_off_once(log, reconstruct, theta, views, noise):
    off = Theta.from_vector(to_vector(theta) + to_vector(TAPE))
    wrong, _ = reconstruct(replace(log(views=views, rows=3, noise=noise), theta=off))
    (remark,) = wrong.method.remarks
    assert "Check the geometry" in remark


def test_auto_chooses_by_the_views_and_gives_the_reason(log, reconstruct):
    fast, _ = reconstruct(log(views=180), method="auto", prefer="speed")
    sparse, _ = reconstruct(log(views=20), method="auto")
    assert (fast.method.name, sparse.method.name) == ("fbp", "ring_tv")
    assert "fbp from 180 views" in fast.method.reason
    assert "ring_tv from 20 views" in sparse.method.reason
    plain, _ = reconstruct(log(views=20), method="fbp")
    assert (plain.method.reason, plain.method.expected_error) == (None, None)


def test_auto_leaves_views_out_where_all_of_them_cost_too_much(log, reconstruct):
    given = log(views=720)
    result, volume = reconstruct(given, method="auto")
    step = result.method.view_step
    assert result.method.name == "ring_tv"
    assert step > 1
    assert result.views == -(-720 // step)
    assert f"{result.views} of the 720 views" in result.method.reason
    thin = replace(given, angles_rad=given.angles_rad[::step], read=lambda a, b: given.read(a, b)[::step])
    _, expected = reconstruct(thin, method="ring_tv")
    np.testing.assert_array_equal(volume, expected)


def test_a_background_is_taken_out_before_slices_are_fitted_to_the_data(log, reconstruct):
    plain, expected = reconstruct(log(), method="tikhonov")
    levelled, volume = reconstruct(log(background=3.0), method="tikhonov")
    # The background is known to a hundredth of the noise: thousands of samples of air.
    assert relative_error(volume, expected) < 0.02
    assert any("background" in remark for remark in levelled.method.remarks)
    assert not any("background" in remark for remark in plain.method.remarks)


def test_a_region_of_interest_is_cut_out_of_all_that_was_scanned(log, reconstruct):
    h = FIELD_MM / SIZE
    asked = {"size": 16, "field_mm": 16 * h, "field_centre_mm": (6 * h, 2 * h)}
    region, part = reconstruct(log(), method="total_variation", **asked)
    assert any("cut out" in remark for remark in region.method.remarks)
    assert part.shape == (1, 16, 16)
    # Without the wood around it the region would be explained by far too much attenuation.
    assert relative_error(part[0], LOG.rasterise(SIZE, FIELD_MM)[22:38, 18:34]) < 0.2
    assert region.method.data_misfit < 1.5


def test_fbp_reports_a_background_that_it_leaves(log, reconstruct):
    result, _ = reconstruct(log(views=60, background=3.0))
    assert any("air=background" in remark for remark in result.method.remarks)
    assert not reconstruct(log(views=60))[0].method.remarks


def test_rows_wider_than_the_middle_one_keep_their_wood(log, reconstruct):
    """A butt that flares: a region of interest needs the wood of its own row around it."""
    given = log(rows=3)
    widths = np.array([1.0, 0.4, 0.4], np.float32)

    def flared(start, stop):
        whole = given.read(start, stop)
        cells = np.arange(whole.shape[2])
        rows = [
            [np.interp((cells - 64.0) / width + 64.0, cells, line) for line in whole[:, n]]
            for n, width in enumerate(widths[start:stop])
        ]
        return np.asarray(rows, np.float32).transpose(1, 0, 2)

    asked = {"method": "tikhonov", "size": 16, "field_mm": 100.0, "alpha": 300.0}
    _, together = reconstruct(replace(given, read=flared), **asked)
    _, alone = reconstruct(replace(given, read=lambda _, __: flared(0, 1), rows=(0, 1)), **asked)
    # The larger field has more empty pixels to share the noise with; without the wood around it, all would be wrong.
    assert relative_error(together[0], alone[0]) < 0.1


def test_what_is_chosen_is_the_same_along_the_log(log, reconstruct):
    """Seventeen slices are two blocks; each slice alone would choose by its own noise."""
    result, volume = reconstruct(log(rows=17), method="cauchy_map", size=24)
    again, single = reconstruct(log(rows=17), method="cauchy_map", size=24, sigma=result.method.sigma)
    # Sigma is a factor times each slice's own noise, here equal to some per cent.
    assert relative_error(volume, single) < 0.05
    assert again.method.sigma == pytest.approx(result.method.sigma, rel=0.05)


def without(given, *empty):
    def read(start, stop):
        return np.where(np.isin(np.arange(start, stop), empty)[:, None], np.float32(0.0), given.read(start, stop))

    return replace(given, read=read)


@pytest.mark.parametrize("method", ITERATIVE)
def test_slices_that_show_nothing_are_empty_and_the_others_as_without_them(log, reconstruct, method):
    """Among others in the first block, and all of the second."""
    given, empty = log(rows=18), (0, 3, 16, 17)
    nothing, asked = np.isin(np.arange(18), empty), {"method": method, "size": 24, "coupling": "none"}
    _, whole = reconstruct(given, **asked)
    result, volume = reconstruct(without(given, *empty), **asked)
    assert not volume[nothing].any()
    # They share the choice of the middle slice and, but for rounding, nothing else.
    assert relative_error(volume[~nothing], whole[~nothing]) < 1e-3
    report = result.method
    assert np.isfinite([report.noise, report.data_misfit, report.worst_data_misfit]).all()
    assert report.worst_data_misfit > 0.0
    assert report.unconverged_slices == 0


@pytest.mark.parametrize("method", ["cauchy_map", "total_variation"])
def test_settings_are_not_chosen_from_a_middle_slice_that_shows_nothing(log, reconstruct, method):
    given = replace(without(log(rows=5), 2), rows=(100, 110), row_step=2)
    sentence = f"row 104, the middle one, from which {method} chooses its settings"
    with pytest.raises(JobFailure, match=sentence) as failure:
        reconstruct(given, method=method, size=24)
    assert failure.value.code == "empty-slice"
    setting = {"cauchy_map": {"sigma": 0.05}, "total_variation": {"weight": 50.0}}[method]
    _, volume = reconstruct(given, method=method, size=24, **setting)
    assert volume.any(axis=(1, 2)).tolist() == [True, True, False, True, True]


def test_the_curve_is_that_of_the_slice_nearest_to_the_middle_that_shows_anything(log, reconstruct, tmp_path):
    result, _ = reconstruct(without(log(rows=17), 7, 8, 9), method="tikhonov", size=24)
    with h5py.File(tmp_path / "volume.h5") as file:
        taken = file["entry/process/alpha_curve/alpha"][()]
    one = replace(log(rows=17), read=lambda _start, _stop: log(rows=17).read(6, 7), rows=(6, 7))
    sixth, _ = reconstruct(one, method="tikhonov", size=24)
    assert taken == pytest.approx(sixth.method.alpha, rel=1e-6)
    assert result.method.alpha != pytest.approx(taken, rel=1e-6)


def test_a_scan_that_shows_nothing_at_all_is_an_empty_volume(log, reconstruct):
    result, volume = reconstruct(without(log(rows=2), 0, 1), method="tikhonov", size=24)
    assert not volume.any()
    assert (result.method.noise, result.method.data_misfit, result.method.alpha) == (0.0, 0.0, None)


def test_counts_are_weighted_by_their_photons(log, reconstruct):
    """Dark rays, with a tenth of the light, weigh less: the image is another one."""
    weighted, volume = reconstruct(log(counts=True), method="cauchy_map")
    plain, same = reconstruct(log(), method="cauchy_map")
    assert weighted.unit == "1/mm"
    assert weighted.method.noise > 1.2 * plain.method.noise
    assert relative_error(volume, same) > 0.01


def test_the_uncertainty_map_is_ignored_with_a_remark(log, reconstruct):
    result, _ = reconstruct(log(), method="cauchy_map", sigma=0.05, uncertainty=True)
    assert not result.has_deviation
    assert sum("uncertainty is ignored" in remark for remark in result.method.remarks) == 1


@pytest.mark.parametrize("rule", ["cross-validation", "discrepancy", "gcv", "l-curve"])
def test_the_curve_that_alpha_was_chosen_from_is_kept(log, reconstruct, tmp_path, rule):
    result, _ = reconstruct(log(), method="tikhonov", alpha_rule=rule)
    with h5py.File(tmp_path / "volume.h5") as file:
        curve = {name: column[()] for name, column in file["entry/process/alpha_curve"].items()}
        assert file["entry/process/method/alpha"][()] == pytest.approx(result.method.alpha)
    assert curve["alpha"] == pytest.approx(result.method.alpha)
    assert (np.diff(curve["residual_norms"]) >= 0.0).all()
    assert ("gcv" in curve) == (rule in {"discrepancy", "gcv"})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "tikhonov", "filter": "ram-lak"}, "filter belongs to method auto or fbp, not tikhonov"),
        ({"method": "tikhonov", "alpha": 1.0, "alpha_rule": "gcv"}, "alpha_rule has nothing to choose"),
        ({"method": "fbp", "prefer": "speed"}, "prefer belongs to method auto, not fbp"),
        ({"non_negative": False}, "non_negative belongs to method cauchy_map or ring_tv or total_variation, not auto"),
        ({"method": "cauchy_map", "preset": "paper", "beta": 0.1}, "preset brings its own sigma and beta"),
        ({"method": "cauchy_map", "sigma": -1.0}, "greater than 0"),
    ],
)
def test_an_option_of_another_method_is_refused(options, message):
    with pytest.raises(ValidationError, match=message):
        ReconstructionOptions(**options)


@pytest.mark.parametrize("options", [{}, {"method": "tikhonov", "alpha": 3.0}])
def test_a_request_with_the_earlier_rule_for_alpha_is_still_read(options):
    assert ReconstructionOptions(alpha_rule="discrepancy", **options).alpha_rule == "discrepancy"


@pytest.mark.parametrize("name", METHODS)
def test_the_fields_of_a_method_are_its_options_of_the_contract(name):
    options = ReconstructionOptions.model_fields
    marks = {option: OptionOf.on(field) for option, field in options.items()}
    own = {option: options[option].default for option, mark in marks.items() if mark and name in mark.methods}
    assert {field.name: field.default for field in fields(METHODS[name])} == own


@pytest.mark.parametrize("options", [{"method": "fbp"}, {"method": "cauchy_map", "sigma": 0.05}])
def test_a_volume_in_memory_is_that_of_the_file(log, reconstruct, options):
    given, seen = log(rows=17), []
    result, volume = reconstruct(given, **options)
    asked = ReconstructionOptions(size=SIZE, field_mm=FIELD_MM, **options)
    in_memory = reconstruct_in_memory(given, given.geometry, asked, seen.append)
    np.testing.assert_array_equal(in_memory.data, volume)
    assert in_memory.result.model_copy(update={"time_s": result.time_s}) == result
    assert seen[-1].seconds_left == 0.0


SLICES = 70
IN_BLOCKS = ReconstructionOptions(method="fbp", size=32, field_mm=420.0)


@pytest.fixture
def given(scanner, theta, sinogram, turn):
    stack = sinogram(turn(20)).astype(np.float32)[:, None] * np.linspace(0.5, 1.5, SLICES, dtype=np.float32)[:, None]
    return reconstruction_input(stack, FanBeamGeometry(scanner, theta, turn(20)), first_row=100, counts=True)


def test_a_volume_of_several_blocks_reports_its_range_and_the_time_left(given, tmp_path):
    reported = []
    result = run_reconstruction(given, given.geometry, IN_BLOCKS, tmp_path / "volume.h5", reported.append)
    with h5py.File(tmp_path / "volume.h5") as file:
        volume = file["entry/reconstruction/data"][()]
        assert file["entry/process/parameters/rows"][()] == b"100:170"
    assert volume.shape == result.shape
    assert result.value_range == pytest.approx(np.percentile(volume, [0.1, 99.9]), rel=1e-6)
    # Twice the line integrals are twice the image, block after block; single precision.
    np.testing.assert_allclose(volume[-1], 3.0 * volume[0], atol=1e-3 * np.abs(volume[0]).max())
    assert reported[0].fraction == 0.0
    assert reported[0].seconds_left > 0.0
    assert reported[-1].seconds_left == 0.0
    assert [progress.fraction for progress in reported] == sorted(progress.fraction for progress in reported)


@pytest.mark.parametrize(
    ("method", "rows"), [("cauchy_map", 1), ("cauchy_map", 17), ("total_variation", 17), ("tikhonov", 1)]
)
def test_an_iterative_method_reports_the_time_left_before_its_first_block_is_done(given, tmp_path, method, rows):
    reported = []
    given = replace(given, rows=(100, 100 + rows), counts=False)
    options = ReconstructionOptions(size=32, field_mm=420.0, method=method)
    run_reconstruction(given, given.geometry, options, tmp_path / "volume.h5", reported.append)
    fractions = [progress.fraction for progress in reported]
    assert fractions == sorted(fractions)
    # Sixteen slices are a block; the last slices are still to be written when they are done.
    within = [progress for progress in reported if 0.0 < progress.fraction < min(rows, 16) / (rows + 1)]
    assert len(within) > 5
    assert within[-1].seconds_left is not None
    assert reported[-1].seconds_left == 0.0


def test_slices_lie_where_their_rows_are_in_the_scan(given, tmp_path):
    given = replace(given, row_step=30, scanner=replace(given.scanner, row_pitch_mm=2.0))
    result = run_reconstruction(given, given.geometry, IN_BLOCKS, tmp_path / "volume.h5", lambda _: None)
    assert (result.rows, result.row_step, result.shape[0]) == ((100, 170), 30, 3)
    with h5py.File(tmp_path / "volume.h5") as file:
        assert file["entry/reconstruction/z"][()].tolist() == [200.0, 260.0, 320.0]
        assert file["entry/process/parameters/rows"][()] == b"100:170:30"


def test_rows_that_cannot_be_read_leave_no_volume(given, tmp_path):
    def failing(start, stop):
        if start and stop - start > 1:
            raise OSError("the scan is damaged")
        return given.read(start, stop)

    with pytest.raises(OSError, match="damaged"):
        run_reconstruction(
            replace(given, read=failing), given.geometry, IN_BLOCKS, tmp_path / "volume.h5", lambda _: None
        )
    assert list(tmp_path.iterdir()) == []


def test_a_volume_larger_than_the_disk_and_a_slice_larger_than_the_memory_are_refused(given, tmp_path, full_disk):
    full_disk(10**5, size_bytes=10**9)
    with pytest.raises(JobFailure, match=r"70 x 32 x 32 needs up to 0\.000287 GB and 0\.0001 GB are free") as failure:
        run_reconstruction(given, given.geometry, IN_BLOCKS, tmp_path / "volume.h5", lambda _: None)
    assert failure.value.code == "disk-full"
    assert list(tmp_path.iterdir()) == []
    failures.check_memory(10**9, 10**9)
    sentence = "one slice needs 3 GB of memory where 2 GB may be used: ask for a smaller size"
    with pytest.raises(JobFailure, match=sentence) as failure:
        failures.check_memory(3 * 10**9, 2 * 10**9)
    assert failure.value.code == "out-of-memory"


def test_memory_is_the_machine_s_or_the_container_s(tmp_path):
    meminfo = tmp_path / "meminfo"
    meminfo.write_text("MemTotal:       16000 kB\nMemAvailable:    8000 kB\n")
    assert failures.memory_available(meminfo, tmp_path) == 8000 * 1024
    (tmp_path / "memory.max").write_text("max\n")
    assert failures.memory_available(meminfo, tmp_path) == 8000 * 1024
    (tmp_path / "memory.max").write_text("5000000\n")
    (tmp_path / "memory.current").write_text("1500000\n")
    # The kernel gives up what it only caches of files.
    (tmp_path / "memory.stat").write_text("anon 900000\ninactive_file 500000\nactive_file 100000\n")
    assert failures.memory_available(meminfo, tmp_path) == 4_000_000
    # A unit of systemd's in a slice: each may have a limit.
    (unit := tmp_path / "system.slice/sawmill.service").mkdir(parents=True)
    (membership := tmp_path / "cgroup").write_text("12:pids:/elsewhere\n0::/system.slice/sawmill.service\n")
    (unit / "memory.max").write_text("2000000\n")
    (unit / "memory.current").write_text("500000\n")
    (unit / "memory.stat").write_text("inactive_file 0\n")
    assert failures.memory_available(meminfo, tmp_path, membership) == 1_500_000
    (unit / "memory.max").write_text("9000000\n")
    assert failures.memory_available(meminfo, tmp_path, membership) == 4_000_000


def test_the_range_of_a_large_volume_comes_from_a_sample_of_bounded_size():
    block = np.random.default_rng(721).standard_normal((10, 512, 512)).astype(np.float32)
    slices = 8 * SAMPLED_VALUES // 512**2
    seen = ValueRange(slices, 512)
    for _ in range(2):
        sample = seen.sample(block)
        assert sample.size <= 10 * SAMPLED_VALUES / slices
        seen.add(sample)
    # The 99.9 percentile of 5 x 10^5 normal numbers is known to 0.02.
    assert seen.percentiles() == pytest.approx((-3.09, 3.09), abs=0.06)


def test_the_range_is_that_of_the_wood_where_a_nail_lies_in_the_slice():
    """A nail of 100 x 4 mm in a field of 384 mm covers 0.3 per cent: the wood would be black."""
    rng = np.random.default_rng(7)
    slice_ = np.zeros((1, 256, 256), np.float32)
    slice_[:, 80:176, 80:176] = rng.normal(0.01, 0.001, (1, 96, 96))
    knots = slice_.copy()
    knots[:, 100:110, 100:120] = 0.02
    nailed = knots.copy()
    nailed[:, 120:187, 128:131] = 0.4
    low, high = zip(*(_range(volume) for volume in (knots, nailed, -slice_)), strict=True)
    assert high[0] == pytest.approx(np.percentile(knots, 99.9)) == pytest.approx(0.02)
    assert 0.02 < high[1] < 0.03
    assert high[2] == 0.0
    assert low[2] < low[0] == 0.0


def _range(volume):
    seen = ValueRange(len(volume), volume.shape[1])
    seen.add(seen.sample(volume))
    return seen.percentiles()
