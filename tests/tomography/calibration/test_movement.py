"""What moved, from the change of the source frame."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sawmill_tomography.calibration.comparison import likely_cause
from sawmill_tomography.geometry.geometry import Scanner, SourceFrame

SCANNER = Scanner(859.46, 768, 1.502864583)
BEFORE = SourceFrame(2.9, 917.0, 1620.0, -209.0, -0.083)
# Of both calibrations together, as 60 views give it: psi, R, SDD, u_c, tau.
DEVIATION = np.array([0.0005, 0.6, 0.8, 0.02, 0.0006])


@pytest.fixture
def reported():
    def cause(deviation=DEVIATION, **changes):
        after = replace(BEFORE, **{name: getattr(BEFORE, name) + change for name, change in changes.items()})
        covariance = None if deviation is None else np.diag(deviation**2)
        return likely_cause(SCANNER, BEFORE, after, covariance, allowed_mm=0.2, radius_mm=150.0)

    return cause


CASES = {
    "the turntable": ({"cor_column_mm": 0.8}, "Check the turntable first."),
    "the detector's mount": ({"tilt_rad": 0.02}, "Check the detector's mount. The detector's tilt"),
    "the detector's stand": ({"source_to_detector_mm": 20.0}, "Check the detector's stand."),
    "the phantom's size": ({"source_distance_mm": 9.0}, "phantom's size is not the stated one"),
    "the source": ({"source_distance_mm": 12.0, "source_to_detector_mm": 12.0}, "Check the source's mount."),
    "a knock": ({"cor_column_mm": 1.5, "tilt_rad": 0.02}, "the detector was knocked"),
    "several": (
        {"cor_column_mm": 3.0, "tilt_rad": 0.03, "source_distance_mm": 15.0, "source_to_detector_mm": -20.0},
        "the scanner was moved, or another phantom was scanned",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_each_thing_that_can_move_is_named_with_where_to_look(reported, name):
    changes, sentence = CASES[name]
    assert sentence in reported(**changes)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("seed", range(1250, 1255))
def test_the_noise_of_both_calibrations_is_no_movement(reported, name, seed):
    changes, sentence = CASES[name]
    noise = DEVIATION * np.random.default_rng(seed).standard_normal(5)
    noisy = {key: changes.get(key, 0.0) + noise[place] for place, key in enumerate(vars(BEFORE))}
    assert sentence in reported(**noisy)


def test_the_movement_is_reported_in_millimetres_and_degrees(reported):
    assert "The COR moved +0.80 mm on the detector and the tilt did not" in reported(cor_column_mm=0.8)
    assert "changed by +1.146 degrees" in reported(tilt_rad=0.02)


def test_a_change_of_the_source_distance_alone_is_given_as_the_size_of_the_phantom(reported):
    """R of 917.0 mm stands for a source shift of 319.7 mm, R of 926.0 mm for one of 344.6 mm; r_S is 859.46 mm."""
    sentence = reported(source_distance_mm=9.0)
    assert "the source shift would be 345 mm, where the active calibration has 320 mm" in sentence
    assert "as with a phantom 1.0 % smaller than its drawing" in sentence
    assert "Check which phantom was scanned" in sentence
    assert "2.2 % larger than its drawing" in reported(source_distance_mm=-20.0)


def test_without_error_bars_what_hardly_moves_the_rays_is_no_movement(reported):
    assert "and the tilt did not" in reported(deviation=None, cor_column_mm=2.0, tilt_rad=math.radians(0.005))


def test_a_turned_phantom_moves_nothing(reported):
    assert reported(psi_rad=1.0, cor_column_mm=0.8) == reported(cor_column_mm=0.8)
