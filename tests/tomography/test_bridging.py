import numpy as np

from sawmill_tomography.sinograms.bridging import bridge, bridged_samples


def test_bridges_are_straight_and_ends_take_their_neighbour():
    ramp = np.tile(np.arange(10, dtype=np.float32), (3, 1))
    broken = ramp.copy()
    faulty = np.isin(np.arange(10), [0, 4, 5, 9])
    broken[:, faulty] = 99.0
    bridge(broken, faulty)
    expected = ramp.copy()
    expected[:, 0], expected[:, 9] = 1.0, 8.0
    np.testing.assert_allclose(broken, expected, atol=1e-6)


def test_samples_of_each_row_are_bridged_on_their_own():
    sinogram = np.arange(12.0).reshape(2, 6) ** 2
    left_out = np.zeros((2, 6), bool)
    left_out[0, [0, 2, 3]] = left_out[1, 5] = True
    found = bridged_samples(sinogram, left_out)
    assert found[0].tolist() == [1.0, 1.0, 6.0, 11.0, 16.0, 25.0]
    assert found[1].tolist() == [36.0, 49.0, 64.0, 81.0, 100.0, 100.0]


def test_a_row_without_good_samples_stays():
    sinogram = np.arange(6.0).reshape(2, 3)
    found = bridged_samples(sinogram, np.array([[True] * 3, [False] * 3]))
    assert np.array_equal(found, sinogram)
