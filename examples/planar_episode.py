"""One episode of the rating-function planner in the planar environment."""

import numpy as np
from PIL import Image

import coopmap_baselines
from coopmap_env import planar_v1

SCANS_EACH = 16
SEED = 0

env = planar_v1.parallel_env(
    n_robots=2, scene="obstacles", split="test", max_scans=SCANS_EACH, render_mode="rgb_array"
)
policy = coopmap_baselines.make("rating_function", search=100)

observations, infos = env.reset(seed=SEED)
policy.reset(np.random.default_rng(SEED))  # all random numbers of the planner come from here
while env.agents:
    actions = policy.act(env.belief(), observations)
    observations, rewards, terminations, truncations, infos = env.step(actions)
    print(
        f"observed {infos['robot_0']['observed_fraction']:.1%}, reward {sum(rewards.values()):.2f}"
    )

Image.fromarray(env.render()).save("planar_episode.png")  # truth, team map and cameras
