"""Cooperative active mapping: robots with cameras build one probabilistic map.

"The paper", whose equations and sections docstrings number, is V. A. Sujan and S. Dubowsky,
"Cooperative mapping by robot teams" (see CITATION.cff).
"""

from types import ModuleType

from coopmap_env import field_v1, planar_v1
from coopmap_env.core.version import __version__
from coopmap_env.envs.registration import register_envs as _register

__all__ = ["__version__", "evaluation", "field_v1", "planar_v1"]

_register()


def __getattr__(name: str) -> ModuleType:
    # loaded on first use: its statistics import scipy.stats, which takes longer than all the rest
    if name == "evaluation":
        import coopmap_env.evaluation as module

        return module
    raise AttributeError(f"module 'coopmap_env' has no attribute {name!r}")
