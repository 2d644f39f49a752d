"""MaskablePPO of sb3-contrib on the Gymnasium environment of the whole team.

pip install "coopmap[rl]" sb3-contrib
"""

import gymnasium
from sb3_contrib import MaskablePPO
from stable_baselines3.common.env_util import make_vec_env

import coopmap_env  # noqa: F401 - registers the ids

env = make_vec_env(
    lambda: gymnasium.make("coopmap/Planar-v1", action_mode="candidates", reward="coverage"),
    n_envs=2,
    seed=0,
)
model = MaskablePPO("MultiInputPolicy", env, n_steps=32, batch_size=32, n_epochs=1, gamma=0.9)
model.learn(total_timesteps=128)  # many more for a good policy
print(f"{model.num_timesteps} steps of the team, {len(model.ep_info_buffer)} episodes")
env.close()
