import math
from dataclasses import replace

import numpy as np
import pytest

from sawmill_tomography.calibration.calibration import choose_theta
from sawmill_tomography.calibration.covariance import theta_covariance
from sawmill_tomography.geometry.geometry import SourceFrame, ThetaBounds, to_vector


@pytest.fixture
def frame(theta, scanner):
    return theta.source_frame(scanner.source_to_cor_mm)


def test_without_bounds_the_source_shift_is_positive_and_the_twin_stands_beside(scanner, theta, frame):
    chosen, twin = choose_theta(scanner, frame, None)
    np.testing.assert_allclose(to_vector(chosen), to_vector(theta), rtol=1e-10)
    np.testing.assert_allclose(to_vector(twin), to_vector(theta.twin(scanner.source_to_cor_mm)), rtol=1e-10)


def test_where_both_are_inside_the_bounds_the_source_shift_is_positive(scanner, frame):
    assert choose_theta(scanner, frame, ThetaBounds())[0].source_shift_mm > 0.0


def test_where_only_the_twin_is_inside_the_bounds_it_is_reported(scanner, theta, frame):
    chosen, twin = choose_theta(scanner, frame, ThetaBounds(source_shift_mm=(-500.0, 0.0)))
    assert chosen.source_shift_mm < 0.0
    np.testing.assert_allclose(to_vector(twin), to_vector(theta), rtol=1e-10)


def test_without_source_shift_there_is_no_twin(scanner, frame):
    theta, twin = choose_theta(scanner, replace(frame, source_distance_mm=scanner.source_to_cor_mm), None)
    assert theta.source_shift_mm == 0.0
    assert twin is None


@pytest.mark.parametrize("twin", [False, True])
def test_the_deviation_of_theta_is_its_scatter(scanner, theta, frame, twin):
    reported = theta.twin(scanner.source_to_cor_mm) if twin else theta
    rng = np.random.default_rng(1401)
    root = rng.standard_normal((5, 5)) * np.array([2e-5, 0.05, 0.05, 0.01, 1e-5])[:, None]
    drawn = []
    for _ in range(2000):
        moved = SourceFrame.from_vector(to_vector(frame) + root @ rng.standard_normal(5))
        sign = -1 if twin else 1
        difference = to_vector(moved.theta(scanner.source_to_cor_mm, source_shift_sign=sign)) - to_vector(reported)
        difference[0] = math.remainder(difference[0], 2.0 * math.pi)
        drawn.append(difference)
    deviation = np.sqrt(np.diag(theta_covariance(scanner, frame, reported, root @ root.T)))
    # 2000 draws know a standard deviation to 1.6 %.
    np.testing.assert_allclose(deviation, np.std(drawn, axis=0), rtol=0.06)


def test_an_unresolved_source_shift_has_no_deviation(scanner, frame):
    covariance = np.diag([1e-8, 1.0, 1.0, 1e-4, 1e-8])
    for beyond, resolved in ((1.9, False), (2.1, True)):
        near = replace(frame, source_distance_mm=scanner.source_to_cor_mm + beyond)
        theta, _ = choose_theta(scanner, near, None)
        assert (theta_covariance(scanner, near, theta, covariance) is not None) is resolved
    covariance[1, 1] = 0.0
    assert theta_covariance(scanner, frame, choose_theta(scanner, frame, None)[0], covariance) is None
