"""Cooperative active mapping: robots with cameras build one probabilistic map.

"The paper", whose equations and sections docstrings number, is V. A. Sujan and S. Dubowsky,
"Cooperative mapping by robot teams" (see CITATION.cff).
"""

from typing import TYPE_CHECKING

from coopmap_env.core.lazy import load_on_first_use
from coopmap_env.core.version import __version__
from coopmap_env.envs.registration import register_envs as _register

__all__ = ["__version__", "evaluation", "field_v1", "planar_v1"]

# Loaded on first use: whoever needs an id, a setting or an error message does not wait for them.
if TYPE_CHECKING:
    import coopmap_env.evaluation as evaluation
    import coopmap_env.field_v1 as field_v1
    import coopmap_env.planar_v1 as planar_v1
else:
    __getattr__ = load_on_first_use(__name__)

_register()
