"""A custom planner, compared with the rating function on the same worlds.

It uses only `Belief`, so it runs in the planar and in the field environment. A package makes it
available to ``coopmap evaluate`` by an entry point of the group ``coopmap.policies``.
"""

import coopmap_baselines
from coopmap_env import planar_v1
from coopmap_env.evaluation import evaluate

N_CANDIDATES = 50
WORLDS = range(5)


class UnknownPerCost:
    """Take the random feasible pose with the most unknown cells per nat of motion cost."""

    def reset(self, rng):
        """Start a new episode; all random numbers come from `rng`."""
        self.rng = rng

    def act(self, belief, observations):
        """Choose one action for each robot."""
        actions = {}
        for robot, agent in enumerate(belief.agents):
            poses = belief.random_poses(robot, N_CANDIDATES, self.rng)
            cost = belief.rate(robot, poses).motion_cost
            unknown = belief.unknown_fraction(robot, poses)
            actions[agent] = belief.action_for(robot, poses[(unknown / (1 + cost)).argmax()])
        return actions


env = planar_v1.parallel_env(split="test", max_scans=8)
policies = {
    "unknown per cost": UnknownPerCost(),
    "rating function": coopmap_baselines.make("rating_function", search=N_CANDIDATES),
}
for name, policy in policies.items():
    table = evaluate(env, policy, WORLDS).table
    print(f"{name:<18} coverage {table['coverage'].mean():.1%}, ", end="")
    print(f"distance {table['motion_distance'].mean():.0f} m")
