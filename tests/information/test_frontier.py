import numpy as np
import pytest

from coopmap_env.information import adjacent_to_unknown
from coopmap_env.mapping import OccupancyMap, VoxelGrid


@pytest.mark.parametrize("shape", [(5, 6), (4, 5, 6)])
def test_a_cell_is_beside_the_unknown_if_a_face_neighbour_was_never_sampled(shape):
    map_ = OccupancyMap(VoxelGrid(shape))
    rng = np.random.default_rng(0)
    sampled = rng.random(shape) < 0.7
    map_.mark_free(np.flatnonzero(sampled))
    beside = adjacent_to_unknown(map_).reshape(shape)
    for index in np.ndindex(*shape):
        expected = False
        for axis in range(len(shape)):
            for step in (-1, 1):
                other = list(index)
                other[axis] += step
                inside = 0 <= other[axis] < shape[axis]
                expected |= inside and not sampled[tuple(other)]
        assert beside[index] == expected
