import numpy as np
import pytest

from sawmill_tomography.reconstruction.quality import relative_error, structural_similarity_index


@pytest.fixture
def truth():
    return np.random.default_rng(801).uniform(0.0, 1.0, (64, 64))


def test_a_perfect_image_has_no_error_and_full_similarity(truth):
    assert relative_error(truth, truth) == 0.0
    assert structural_similarity_index(truth, truth) == pytest.approx(1.0, abs=1e-12)


def test_the_relative_error_is_the_ratio_of_norms(truth):
    assert relative_error(np.zeros_like(truth), truth) == pytest.approx(1.0)
    assert relative_error(1.1 * truth, truth) == pytest.approx(0.1)
    assert relative_error([[3.0, 0.0]], [[0.0, 4.0]]) == pytest.approx(1.25)


def test_neither_depends_on_the_unit(truth):
    image = truth + 0.1 * np.random.default_rng(802).standard_normal(truth.shape)
    assert relative_error(50.0 * image, 50.0 * truth) == pytest.approx(relative_error(image, truth))
    assert structural_similarity_index(50.0 * image, 50.0 * truth) == pytest.approx(
        structural_similarity_index(image, truth)
    )


def test_more_noise_is_less_similar(truth):
    noise = np.random.default_rng(803).standard_normal(truth.shape)
    values = [structural_similarity_index(truth + level * noise, truth) for level in (0.05, 0.2, 0.8)]
    assert values[0] > values[1] > values[2]
