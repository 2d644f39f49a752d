"""How much any policy can show in a world: upper bounds with certificates; see docs/bounds.md."""

from coopmap_env.evaluation.bounds.certificate import Certificate, PoseSets, ViewScores
from coopmap_env.evaluation.bounds.planar_views import PlanarViews
from coopmap_env.evaluation.bounds.search import BoundSearch, ShownBound, bound_shown

__all__ = [
    "BoundSearch",
    "Certificate",
    "PlanarViews",
    "PoseSets",
    "ShownBound",
    "ViewScores",
    "bound_shown",
]
