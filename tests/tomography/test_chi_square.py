"""The chi-square of a small probability, against SciPy's."""

import math

import pytest
from scipy.special import chdtri

from sawmill_tomography.statistics import exceeded_chi_square


@pytest.mark.parametrize("degrees", [1, 1.3, 2, 3, 4.9, 7, 33, 361, 5000])
def test_a_chi_square_is_exceeded_with_its_probability(degrees):
    for probability in (0.5, 0.3, 0.01, 1e-5, 1e-9, 1e-20):
        assert exceeded_chi_square(probability, degrees) == pytest.approx(chdtri(degrees, probability), rel=1e-12)


def test_what_is_no_number_has_no_chi_square():
    assert math.isnan(exceeded_chi_square(math.nan, 3))
    assert math.isnan(exceeded_chi_square(0.01, math.nan))
