"""Scenes: where worlds come from, and the frozen splits of their seeds.

`planar` holds the scenes of the planar environment, `field` those of the field environment.
"""

from coopmap_env.simulation.scenes.factory import SceneError
from coopmap_env.simulation.scenes.splits import SPLITS, world_seed, world_seed_words

__all__ = ["SPLITS", "SceneError", "world_seed", "world_seed_words"]
