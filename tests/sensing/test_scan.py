"""A scan: arrays that belong together."""

import numpy as np
import pytest

from coopmap_env.sensing import Scan


def test_a_scan_of_no_beams_is_a_scan():
    scan = Scan(np.zeros(3), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, dtype=bool))
    assert len(scan.points) == 0


@pytest.mark.parametrize(
    ("origin", "covariances", "hit"),
    [
        ((3,), (4, 2, 2), (4,)),
        ((2,), (4, 3, 3), (4,)),
        ((2,), (3, 2, 2), (4,)),
        ((2,), (4, 2, 2), (5,)),
    ],
)
def test_arrays_of_different_sizes_are_rejected(origin, covariances, hit):
    with pytest.raises(ValueError, match="a scan of 4 points needs origin"):
        Scan(np.zeros(origin), np.zeros((4, 2)), np.zeros(covariances), np.zeros(hit, dtype=bool))
