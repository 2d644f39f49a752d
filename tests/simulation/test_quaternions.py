import numpy as np
from scipy.spatial.transform import Rotation

from coopmap_env.simulation.physics.client import quaternion_from_matrix


def test_a_quaternion_is_that_of_its_rotation_matrix():
    rotations = Rotation.random(50, rng=np.random.default_rng(0))
    about_z = [Rotation.from_euler("z", angle) for angle in (-3.0, -1.26, 0.0, 1.57, np.pi)]
    for rotation in (*rotations, *about_z):
        found = Rotation.from_quat(quaternion_from_matrix(rotation.as_matrix()))
        np.testing.assert_allclose(found.as_matrix(), rotation.as_matrix(), atol=1e-12)
