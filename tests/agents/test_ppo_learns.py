import numpy as np
import pytest
from coopmap_agents.ppo import LearnedPolicy, PPOSettings, load, save, train
from coopmap_baselines import make

from coopmap_env import planar_v0
from coopmap_env.evaluation import evaluate
from coopmap_env.evaluation.statistics import bootstrap_paired_difference
from coopmap_env.sensing import PlanarCamera
from coopmap_env.simulation.scenes import Obstacles

SETTINGS = planar_v0.PlanarSettings(
    camera=PlanarCamera(depth_of_field=10.0), reach=6.0, start_spread=10.0, view_cells=32
)
SEEDS = range(40)


def world(split="train"):
    return planar_v0.parallel_env(
        reward="information",
        scene=Obstacles(shape=(64, 64)),
        split=split,
        max_scans=12,
        settings=SETTINGS,
    )


class AnyAction:
    """Uniform in the action space: what an untrained policy explores with."""

    def reset(self, rng):
        self.rng = rng

    def act(self, belief, observations):
        return {agent: self.rng.uniform(-1, 1, 3) for agent in observations}


@pytest.mark.slow
def test_ppo_beats_random_actions_and_random_feasible_poses_on_worlds_it_has_not_seen(tmp_path):
    model = train(world, PPOSettings(total_steps=24_000, learning_rate=1e-3), seed=0)
    learned = evaluate(world("test"), LearnedPolicy(model), SEEDS).table["reward"]
    for other in (AnyAction(), make("random")):
        rewards = evaluate(world("test"), other, SEEDS).table["reward"]
        gain = bootstrap_paired_difference(learned, rewards, np.random.default_rng(0))
        print(f"{type(other).__name__}: PPO {learned.mean():.2f}, {rewards.mean():.2f}, {gain}")
        assert gain.low > 0
    save(model, tmp_path / "model.zip")
    again = evaluate(world("test"), LearnedPolicy(load(tmp_path / "model.zip")), SEEDS)
    np.testing.assert_array_equal(again.table["reward"], learned)
