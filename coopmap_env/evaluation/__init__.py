"""One honest evaluation for planners and learned policies alike.

``evaluate`` plays one policy, ``compare`` many on the same worlds; ``summarize`` gives intervals.
"""

from typing import TYPE_CHECKING, Any

from coopmap_env.evaluation.policy import Policy, make_policy, policy_names

if TYPE_CHECKING:
    from coopmap_env.evaluation.comparison import Evaluation, compare, evaluate, summarize

__all__ = [
    "Evaluation",
    "Policy",
    "compare",
    "evaluate",
    "make_policy",
    "policy_names",
    "summarize",
]


def __getattr__(name: str) -> Any:
    # loaded on first use, as in `coopmap_env`: policies need no statistics
    if name in __all__:
        from coopmap_env.evaluation import comparison

        return getattr(comparison, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
