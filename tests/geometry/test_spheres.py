import numpy as np

from coopmap_env.geometry import Spheres, join_spheres


def test_joined_spheres_are_new_arrays_in_their_order():
    one = Spheres(np.arange(6.0).reshape(2, 3), np.array([0.5, 0.25]))
    other = Spheres(np.ones((1, 3)), np.array([2.0]))
    joined = join_spheres([one, other])
    np.testing.assert_array_equal(joined.centers, [[0, 1, 2], [3, 4, 5], [1, 1, 1]])
    np.testing.assert_array_equal(joined.radii, [0.5, 0.25, 2.0])
    for part in (*one, *other):
        part.flags.writeable = False
    alone = join_spheres([one])
    for part, own in zip(alone, one, strict=True):
        part += 1.0
        np.testing.assert_array_equal(part - 1.0, own)
    assert [part.shape for part in join_spheres([])] == [(0, 3), (0,)]
