import numpy as np

from sawmill_worker.tomography.bridging import bridge


def test_bridges_are_straight_and_ends_take_their_neighbour():
    ramp = np.tile(np.arange(10, dtype=np.float32), (3, 1))
    broken = ramp.copy()
    faulty = np.isin(np.arange(10), [0, 4, 5, 9])
    broken[:, faulty] = 99.0
    bridge(broken, faulty)
    expected = ramp.copy()
    expected[:, 0], expected[:, 9] = 1.0, 8.0
    np.testing.assert_allclose(broken, expected, atol=1e-6)
