"""A reconstruction in blocks: refused before it starts where it cannot fit, and whole or not there at all."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from reconstruction_inputs import reconstruction_input

from sawmill_calibration import capacity
from sawmill_calibration.reconstruction.reconstruct import (
    SAMPLED_VALUES,
    ValueRange,
    run_reconstruction,
)
from sawmill_contracts.reconstructions import ReconstructionOptions
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_tomography.geometry.geometry import FanBeamGeometry

pytestmark = pytest.mark.slow

SLICES = 70
OPTIONS = ReconstructionOptions(method="fbp", size=32, field_mm=420.0)


@pytest.fixture
def given(scanner, theta, sinogram, turn):
    factors = np.linspace(0.5, 1.5, SLICES, dtype=np.float32)
    stack = sinogram(turn(20)).astype(np.float32)[:, None] * factors[:, None]
    return reconstruction_input(stack, FanBeamGeometry(scanner, theta, turn(20)), first_row=100, counts=True)


def test_a_volume_of_several_blocks_reports_its_range_and_the_time_left(given, tmp_path):
    reported = []
    result = run_reconstruction(given, given.geometry, OPTIONS, tmp_path / "volume.h5", reported.append)
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
    result = run_reconstruction(given, given.geometry, OPTIONS, tmp_path / "volume.h5", lambda _: None)
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
            replace(given, read=failing), given.geometry, OPTIONS, tmp_path / "volume.h5", lambda _: None
        )
    assert list(tmp_path.iterdir()) == []


def test_a_volume_larger_than_the_disk_is_refused(given, tmp_path, full_disk):
    full_disk(10**5, size_bytes=10**9)
    with pytest.raises(JobFailure, match=r"70 x 32 x 32 needs up to 0\.000287 GB and 0\.0001 GB are free") as failure:
        run_reconstruction(given, given.geometry, OPTIONS, tmp_path / "volume.h5", lambda _: None)
    assert failure.value.code == "disk-full"
    assert list(tmp_path.iterdir()) == []


def test_a_slice_larger_than_the_memory_is_refused():
    capacity.check_memory(10**9, 10**9)
    with pytest.raises(
        JobFailure, match=r"one slice needs 3 GB of memory where 2 GB may be used: ask for a smaller size"
    ) as failure:
        capacity.check_memory(3 * 10**9, 2 * 10**9)
    assert failure.value.code == "out-of-memory"


def test_memory_is_the_machine_s_or_the_container_s(tmp_path):
    meminfo = tmp_path / "meminfo"
    meminfo.write_text("MemTotal:       16000 kB\nMemAvailable:    8000 kB\n")
    assert capacity.memory_available(meminfo, tmp_path) == 8000 * 1024
    (tmp_path / "memory.max").write_text("max\n")
    assert capacity.memory_available(meminfo, tmp_path) == 8000 * 1024
    (tmp_path / "memory.max").write_text("5000000\n")
    (tmp_path / "memory.current").write_text("1500000\n")
    # The kernel gives up what it only caches of files.
    (tmp_path / "memory.stat").write_text("anon 900000\ninactive_file 500000\nactive_file 100000\n")
    assert capacity.memory_available(meminfo, tmp_path) == 4_000_000
    # A unit of systemd's in a slice: each may have a limit.
    (unit := tmp_path / "system.slice/sawmill.service").mkdir(parents=True)
    (membership := tmp_path / "cgroup").write_text("12:pids:/elsewhere\n0::/system.slice/sawmill.service\n")
    (unit / "memory.max").write_text("2000000\n")
    (unit / "memory.current").write_text("500000\n")
    (unit / "memory.stat").write_text("inactive_file 0\n")
    assert capacity.memory_available(meminfo, tmp_path, membership) == 1_500_000
    (unit / "memory.max").write_text("9000000\n")
    assert capacity.memory_available(meminfo, tmp_path, membership) == 4_000_000


def test_the_range_of_a_large_volume_comes_from_a_sample_of_bounded_size():
    rng = np.random.default_rng(721)
    block = rng.standard_normal((10, 512, 512)).astype(np.float32)
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
