import numpy as np
import pytest
from plain.pile_columns import vertical_extent

from coopmap_env.geometry import Z_AXIS, random_rotation, rotation_about_axis
from coopmap_env.simulation.scenes.field._pile import SINK_DEPTH, Pile, vertical_extents

NO_TURN = np.eye(3)


def test_chords_agree_with_sampled_heights():
    rng = np.random.default_rng(0)
    for _ in range(10):
        size, rotation = rng.uniform(0.2, 1.0, 3), random_rotation(rng)
        x, y = rng.uniform(-0.6, 0.6, (2, 6))
        low, high = vertical_extents(size, rotation, x, y)
        for i, j in np.ndindex(6, 6):
            lowest, highest = vertical_extent(size, rotation, x[i], y[j])
            if high[i, j] - low[i, j] > 2e-3:
                assert low[i, j] == pytest.approx(lowest, abs=1.1e-3)
                assert high[i, j] == pytest.approx(highest, abs=1.1e-3)
            else:
                assert highest - lowest < 3e-3


def test_upright_blocks_have_the_same_chord_everywhere_and_none_beside_them():
    low, high = vertical_extents(
        np.array([1.0, 2.0, 0.4]), NO_TURN, np.array([0.0, 0.49, 0.51]), np.zeros(1)
    )
    assert low[:, 0].tolist() == [-0.2, -0.2, np.inf]
    assert high[:, 0].tolist() == [0.2, 0.2, -np.inf]


def test_blocks_rest_on_the_ground_and_then_on_each_other():
    pile, size = Pile(2.0), np.array([0.8, 0.8, 0.4])
    first = pile.find_rest(size, np.zeros(2), NO_TURN)
    assert first.support == -1
    assert first.center.tolist() == [0.0, 0.0, pytest.approx(0.2 - SINK_DEPTH)]
    pile.add(7, first)
    second = pile.find_rest(size, np.array([0.3, 0.0]), rotation_about_axis(Z_AXIS, 0.5))
    assert second.support == 7
    assert second.center[2] == pytest.approx(0.6 - 2 * SINK_DEPTH)
    assert second.top == pytest.approx(0.8 - 2 * SINK_DEPTH)
    beside = pile.find_rest(size, np.array([1.0, 0.0]), NO_TURN)
    assert beside.support == -1


def test_a_pile_only_grows_and_never_above_the_top_of_a_block():
    rng = np.random.default_rng(1)
    pile = Pile(2.0)
    for k in range(30):
        rest = pile.find_rest(rng.uniform(0.3, 0.8, 3), rng.uniform(-1, 1, 2), random_rotation(rng))
        before = pile.heights.copy()
        pile.add(k, rest)
        assert (pile.heights >= before).all()
        assert rest.top + 1e-9 >= np.max(rest.tops)
