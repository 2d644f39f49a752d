"""The families of planners, each with a sweep of the price of motion.

A planner that pays for motion is no fair opponent of a policy that does not. So every family is
played with several motion weights, independent and sequential, and compared where it is strongest
(`tuning`) and at equal motion (`equal_motion`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

MOTION_WEIGHTS: Mapping[str, Mapping[str, tuple[float | None, ...]]] = {
    "planar": {
        "rating_function": (0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, None),
        "coverage": (0, 0.0005, 0.001, 0.002, 0.006, 0.015, 0.03),
        "information_gain": (0, 0.0005, 0.001, 0.002, 0.006, 0.015, 0.03),
        "frontier": (None,),
    },
    "field": {
        "rating_function": (0, 0.02, 0.05, 0.1, None),
        "coverage": (0, 0.003, 0.006, 0.012, 0.025),
        "information_gain": (0, 0.003, 0.006, 0.012, 0.025),
        "frontier": (None,),
    },
}
"""Motion weights of each family by environment, from none to one that halves the motion.

None is the default: of the rating function the environment's K (0.005 and 0.2), of the frontier
planner its own.
"""
SEARCH_POSES = 100
"""m: random poses of a decision, for tuning planners in "pose" mode. The strongest planner with any
pose is the strongest one with this m."""
SEARCHING = ("rating_function", "coverage", "information_gain")
"""Families that search among m random poses, in "pose" mode."""
COORDINATIONS = ("independent", "sequential")


def sweep_specs(family: str, env_name: str, search: int | None = None) -> Iterator[str]:
    """Specs of all planners of a family.

    Parameters
    ----------
    family : str
        A key of `MOTION_WEIGHTS`.
    env_name : {"planar", "field"}
    search : int, optional
        Number of random poses; not given where the environment has candidates.
    """
    for coordination in COORDINATIONS:
        for weight in MOTION_WEIGHTS[env_name][family]:
            yield planner_spec(family, weight, coordination, search)


def planner_spec(
    family: str, weight: float | None, coordination: str, search: int | None = None
) -> str:
    """Spec of one planner, without the options that are defaults."""
    options = []
    if search is not None and family in SEARCHING:
        options.append(f"search={search}")
    if weight is not None:
        options.append(f"motion_weight={weight:g}")
    if coordination != "independent":
        options.append(f"coordination={coordination}")
    return f"{family}:{'+'.join(options)}".removesuffix(":")
