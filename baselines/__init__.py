"""The reference planners, all through the `Policy` protocol; installed as `coopmap_baselines`.

====================  ==========================================================================
name                  next poses
====================  ==========================================================================
rating_function       highest rating (Eq. 9), exhaustively or among m random poses (the paper's)
information_gain      highest mutual information of the beams with the map, minus motion
coverage              most never-sampled cells in view, minus motion
frontier              most cells expected to be new at a frontier, minus motion; or the nearest one
allocation            the same, each robot in another cluster of frontier cells (Hungarian method)
projection            most frontier projected into the view as ellipsoids, minus motion
tour                  the first of a few viewpoints that cover the unknown, on a short path
lookahead             the first of the next few views that are expected to show most
surface               most new surface expected in view, in the field
raster                the next of the available poses, in sequence
random                any feasible pose
====================  ==========================================================================
"""

from typing import Any

from coopmap_baselines.allocation import AllocationPolicy
from coopmap_baselines.coverage import CoveragePolicy
from coopmap_baselines.frontier import FrontierPolicy
from coopmap_baselines.information_gain import InformationGainPolicy
from coopmap_baselines.lookahead import LookaheadPolicy
from coopmap_baselines.projection import ProjectionPolicy
from coopmap_baselines.random_poses import RandomPolicy
from coopmap_baselines.raster import RasterPolicy
from coopmap_baselines.rating_function import RatingFunctionPolicy
from coopmap_baselines.surface import SurfacePolicy
from coopmap_baselines.tour import TourPolicy
from coopmap_env.core.choices import check_keywords, unknown
from coopmap_env.evaluation import Policy

__all__ = [
    "POLICIES",
    "AllocationPolicy",
    "CoveragePolicy",
    "FrontierPolicy",
    "InformationGainPolicy",
    "LookaheadPolicy",
    "ProjectionPolicy",
    "RandomPolicy",
    "RasterPolicy",
    "RatingFunctionPolicy",
    "SurfacePolicy",
    "TourPolicy",
    "make",
]

POLICIES: dict[str, type[Policy]] = {
    "rating_function": RatingFunctionPolicy,
    "information_gain": InformationGainPolicy,
    "coverage": CoveragePolicy,
    "frontier": FrontierPolicy,
    "allocation": AllocationPolicy,
    "projection": ProjectionPolicy,
    "tour": TourPolicy,
    "lookahead": LookaheadPolicy,
    "surface": SurfacePolicy,
    "raster": RasterPolicy,
    "random": RandomPolicy,
}
"""Baselines by name. For the commands and `coopmap_env.evaluation.make_policy`, ``pyproject.toml``
registers them under the same names; a test compares the two."""


def make(name: str, **options: Any) -> Policy:
    """Make a baseline by its name.

    Parameters
    ----------
    name : str
        A key of `POLICIES`.
    **options
        As the policy's class takes them, such as ``search=100`` or ``coordination="sequential"``.

    Raises
    ------
    ValueError
        If the name is unknown or an option's value is not accepted.
    """
    if not isinstance(name, str) or name not in POLICIES:
        raise ValueError(unknown("policy", name, POLICIES))
    try:
        check_keywords(name, options, POLICIES[name])
        return POLICIES[name](**options)
    except TypeError as error:
        raise ValueError(f"policy {name!r}: {error}") from error
