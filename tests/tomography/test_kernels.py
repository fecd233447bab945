"""No kernel reads or writes beyond its arrays, whatever numbers it is given; Numba's cache that cannot be written."""

import errno
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from machine_faults import at_call, refusing
from numba import config
from numba.core.caching import FunctionCache
from structlog.testing import capture_logs

from sawmill_tomography import kernel_cache
from sawmill_tomography.geometry.geometry import FanBeamGeometry, GeometryError, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector

SCANNER = Scanner(859.46, 768, 1.502864583)


@pytest.mark.slow
def test_no_kernel_crashes_on_numbers_that_no_scanner_has():
    fuzz = [sys.executable, str(Path(__file__).with_name("kernel_fuzz.py")), "1", "20"]
    ended = subprocess.run(fuzz, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, f"exit code {ended.returncode}: {ended.stderr}"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["initial_angle_rad", "detector_to_cor_mm", "detector_shift_mm", "detector_tilt"])
@pytest.mark.parametrize("value", [1e300, float("inf"), float("nan")])
def test_a_theta_that_no_scanner_has_is_refused_with_its_value(name, value):
    five = {**vars(Theta(2.55, 714.7, 319.9, 43.7, 0.281)), name: value}
    with pytest.raises(GeometryError, match=f"{name} must lie between -100000 and 100000, not"):
        FanBeamGeometry(SCANNER, Theta(**five), [0.0, 1.0])


@pytest.mark.slow
def test_more_than_the_kernels_can_count_is_refused():
    theta = Theta(2.55, 714.7, 319.9, 43.7, 0.281)
    with pytest.raises(GeometryError, match="size must be at most 65532 pixels, not 65533"):
        Projector(FanBeamGeometry(SCANNER, theta, [0.0]), ImageGrid(65_533, 400.0))
    wide = Scanner(859.46, 2**17, 1e-3)
    with pytest.raises(GeometryError, match="16384 views of 131072 cells are too many: at most 16383 views"):
        Projector(FanBeamGeometry(wide, theta, [0.0] * 2**14), ImageGrid(16, 400.0))


KERNEL = """
from numba import njit

@njit(cache=True)
def double(number):
    return 2 * number
"""


@pytest.fixture
def kernels(tmp_path, monkeypatch):
    (tmp_path / "kernels_of_a_test.py").write_text(KERNEL)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(config, "CACHE_DIR", "")  # it is kept next to its file, whatever NUMBA_CACHE_DIR says
    yield import_module("kernels_of_a_test")
    del sys.modules["kernels_of_a_test"]


@pytest.fixture
def only_read():
    """What a process of an attempt does to Numba for good, and this process only for a test."""
    keep = FunctionCache.save_overload
    kernel_cache.only_read()
    yield
    FunctionCache.save_overload = keep


@pytest.mark.usefixtures("only_read")
def test_a_kernel_that_cannot_be_kept_is_named_in_the_log_and_used(kernels, tmp_path):
    with capture_logs() as log, at_call("os.rename", refusing(errno.EACCES), below=tmp_path):
        assert kernels.double(3) == 6
    assert [(line["event"], "double" in line["kernel"]) for line in log] == [("kernel-not-kept", True)]


def test_a_module_whose_kernels_nobody_compiled_is_noticed(kernels):
    assert not kernel_cache.holds_all(kernels)
    assert kernels.double(3) == 6
    assert kernel_cache.holds_all(kernels)
