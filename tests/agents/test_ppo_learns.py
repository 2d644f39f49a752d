import numpy as np
import pytest

from coopmap_agents.config import PPOSettings
from coopmap_agents.pretrained import LearnedPolicy, save_policy
from coopmap_agents.sb3 import train
from coopmap_baselines import make
from coopmap_env import planar_v1
from coopmap_env.evaluation import evaluate
from coopmap_env.evaluation.statistics import bootstrap_paired_difference
from coopmap_env.sensing import PlanarCamera
from coopmap_env.simulation.scenes.planar import Obstacles

SETTINGS = planar_v1.PlanarSettings(
    camera=PlanarCamera(depth_of_field=10.0), reach=6.0, max_start_distance=10.0, crop_cells=32
)
SEEDS = range(40)


def world(split="train"):
    return planar_v1.parallel_env(
        reward="information",
        scene=Obstacles(shape=(64, 64)),
        split=split,
        max_scans=12,
        settings=SETTINGS,
    )


class AnyAction:
    """Uniform in the action space."""

    def reset(self, rng):
        self.rng = rng

    def act(self, belief, observations):
        return {agent: self.rng.uniform(-1, 1, 3) for agent in observations}


@pytest.mark.slow
def test_ppo_beats_random_actions_and_random_feasible_poses_on_unseen_worlds(tmp_path):
    settings = PPOSettings(total_steps=12_000, learning_rate=1e-3)
    model = train(world, settings, seed=0)
    learned = evaluate(world("test"), LearnedPolicy(model), SEEDS).table["reward"]
    for other in (AnyAction(), make("random")):
        rewards = evaluate(world("test"), other, SEEDS).table["reward"]
        gain = bootstrap_paired_difference(learned, rewards, np.random.default_rng(0))
        print(f"{type(other).__name__}: PPO {learned.mean():.2f}, {rewards.mean():.2f}, {gain}")
        assert gain.low > 0
    save_policy(model.policy, settings, tmp_path / "policy.safetensors")
    again = evaluate(world("test"), LearnedPolicy(tmp_path / "policy.safetensors"), SEEDS)
    np.testing.assert_array_equal(again.table["reward"], learned)
