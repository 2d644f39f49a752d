"""Cooperative active mapping: robots with cameras build one probabilistic map."""

from coopmap_env import evaluation, planar_v0
from coopmap_env.envs.registration import register as _register

__version__ = "0.1.0"
__all__ = ["evaluation", "planar_v0"]

_register()
