"""One honest evaluation for planners and learned policies alike."""

from coopmap_env.evaluation.evaluate import Evaluation, compare, evaluate, summarize
from coopmap_env.evaluation.policy import Policy, make_policy, policy_names

__all__ = [
    "Evaluation",
    "Policy",
    "compare",
    "evaluate",
    "make_policy",
    "policy_names",
    "summarize",
]
