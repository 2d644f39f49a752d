import numpy as np
import pytest

from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.simulation.scenes.planar import Obstacles


def in_cells_of(resolution, **changes):
    """An environment in the same world, but for the length of its cells."""
    scene = Obstacles(resolution=resolution, side_min=4.0 * resolution, side_max=20.0 * resolution)
    return PlanarEnv(scene=scene, max_scans=4, **changes)


def test_cells_of_one_metre_have_the_default_settings():
    assert PlanarSettings.for_resolution(1.0) == PlanarSettings()
    assert PlanarEnv().settings == PlanarSettings()


# powers of two scale without rounding: the noise of every reading is then the same in cells
@pytest.mark.parametrize("resolution", [0.125, 0.5, 4.0])
def test_scaled_settings_play_the_same_episode_in_cells_of_any_size(resolution):
    plain, scaled = in_cells_of(1.0), in_cells_of(resolution)
    plain.reset(seed=4)
    scaled.reset(seed=4)
    np.testing.assert_array_equal(plain.truth.occupied, scaled.truth.occupied)
    rng = np.random.default_rng(0)
    while plain.agents:
        actions = {agent: rng.uniform(-0.3, 0.3, 3) for agent in plain.agents}
        observations, rewards, _, _, infos = plain.step(actions)
        same, scaled_rewards, _, _, other_infos = scaled.step(actions)
        for agent, reward in scaled_rewards.items():
            assert reward == pytest.approx(rewards[agent], rel=1e-12)
            assert other_infos[agent]["rejected_reason"] == infos[agent]["rejected_reason"]
            assert other_infos[agent]["reward_coverage"] == infos[agent]["reward_coverage"]
            np.testing.assert_array_equal(same[agent]["map"], observations[agent]["map"])
            np.testing.assert_allclose(
                same[agent]["teammates"], observations[agent]["teammates"], atol=1e-7
            )


@pytest.mark.parametrize("resolution", [0.1, 0.135, 0.2, 0.3, 3.0])
def test_a_view_has_as_many_cells_at_every_resolution(resolution):
    env, scaled = in_cells_of(1.0), in_cells_of(resolution)
    env.reset(seed=0)
    scaled.reset(seed=0)
    fan, same = env.belief().rating_function.fan, scaled.belief().rating_function.fan
    assert same.depth == pytest.approx(fan.depth)
    # rounding decides on cells that a beam just touches
    assert same.max_visible_cells == pytest.approx(fan.max_visible_cells, abs=3)


def test_settings_given_are_the_ones_used():
    settings = PlanarSettings(reach=7.5, n_headings=8, crop_cells=20)
    env = PlanarEnv(scene="rooms", settings=settings)
    env.reset(seed=0)
    assert env.settings is settings
    assert env.belief().reach == 7.5
    assert env.belief().lattice.n_headings == 8
    assert env.observation_space("robot_0")["map"].shape == (4, 20, 20)
