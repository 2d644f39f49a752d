import numpy as np
import pytest

from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.envs.planar import PlanarTeamEnv as TeamEnv
from coopmap_env.evaluation import make_policy, rollout
from coopmap_env.simulation.scenes.planar import Obstacles

pytest.importorskip("PIL")
SMALL = Obstacles(shape=(48, 48))
STAY = np.zeros(3)


@pytest.mark.parametrize("make", [PlanarEnv, TeamEnv])
def test_rgb_array_gives_a_picture_that_changes_with_a_scan(make):
    env = make(render_mode="rgb_array", scene=SMALL)
    env.reset(seed=0)
    before = env.render()
    assert before.dtype == np.uint8
    assert before.ndim == 3
    assert before.shape[2] == 3
    np.testing.assert_array_equal(env.render(), before)
    action = dict.fromkeys(env.agents, STAY) if make is PlanarEnv else np.zeros(6)
    env.step(action)
    after = env.render()
    assert after.shape == before.shape
    assert (after != before).any()


def test_a_large_map_is_shown_as_far_as_it_is_explored_in_pictures_of_one_shape():
    env = PlanarEnv(render_mode="rgb_array", max_scans=12, n_robots=4)
    frames = []
    for _ in rollout(env, make_policy("random"), 0):
        frames.append(env.render())
    assert len({frame.shape for frame in frames}) == 1
    red = [(frame == (214, 39, 40)).all(axis=-1) for frame in frames]
    widths = [np.ptp(np.nonzero(mask[:, :600])[1]) + 1 for mask in red if mask.any()]
    assert len(widths) > 1
    assert widths == sorted(widths)
    assert widths[0] < 70


def test_a_small_map_is_shown_whole():
    env = PlanarEnv(render_mode="rgb_array", scene=SMALL)
    env.reset(seed=0)
    assert not (env.render() == (214, 39, 40)).all(axis=-1).any()


def test_the_picture_can_still_be_taken_after_the_end():
    env = PlanarEnv(render_mode="rgb_array", scene=SMALL, max_scans=1)
    env.reset(seed=0)
    env.step(dict.fromkeys(env.agents, STAY))
    assert env.agents == []
    assert env.render().any()


def test_without_a_render_mode_there_is_no_picture():
    env = PlanarEnv(scene=SMALL)
    env.reset(seed=0)
    assert env.render() is None


def test_human_mode_opens_a_window_with_reset_and_step_and_closes_it(monkeypatch):
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    shown = []
    env = PlanarEnv(render_mode="human", scene=SMALL, max_scans=2)
    flip = pygame.display.flip
    monkeypatch.setattr(pygame.display, "flip", lambda: (shown.append(1), flip()))
    env.reset(seed=0)
    assert len(shown) == 1
    env.step(dict.fromkeys(env.agents, STAY))
    assert len(shown) == 2
    assert env.render() is None
    assert len(shown) == 3
    assert pygame.display.get_surface() is not None
    env.close()
    env.close()
    assert pygame.display.get_surface() is None
