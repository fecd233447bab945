"""No kernel reads or writes beyond its arrays, whatever numbers it is given."""

import subprocess
import sys
from pathlib import Path

import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry, GeometryError, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector

pytestmark = pytest.mark.slow

SCANNER = Scanner(859.46, 768, 1.502864583)


def test_no_kernel_crashes_on_numbers_that_no_scanner_has():
    fuzz = [sys.executable, str(Path(__file__).with_name("kernel_fuzz.py")), "1", "20"]
    ended = subprocess.run(fuzz, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, f"exit code {ended.returncode}: {ended.stderr}"


@pytest.mark.parametrize("name", ["initial_angle_rad", "detector_to_cor_mm", "detector_shift_mm", "detector_tilt"])
@pytest.mark.parametrize("value", [1e300, float("inf"), float("nan")])
def test_a_theta_that_no_scanner_has_is_refused_with_its_value(name, value):
    five = {**vars(Theta(2.55, 714.7, 319.9, 43.7, 0.281)), name: value}
    with pytest.raises(GeometryError, match=f"{name} must lie between -100000 and 100000, not"):
        FanBeamGeometry(SCANNER, Theta(**five), [0.0, 1.0])


def test_more_than_the_kernels_can_count_is_refused():
    theta = Theta(2.55, 714.7, 319.9, 43.7, 0.281)
    with pytest.raises(GeometryError, match="size must be at most 65532 pixels, not 65533"):
        Projector(FanBeamGeometry(SCANNER, theta, [0.0]), ImageGrid(65_533, 400.0))
    wide = Scanner(859.46, 2**30, 1e-6)
    with pytest.raises(GeometryError, match="2 views of 1073741824 cells are too many: at most 1 views"):
        Projector(FanBeamGeometry(wide, theta, [0.0, 1.0]), ImageGrid(16, 400.0))
