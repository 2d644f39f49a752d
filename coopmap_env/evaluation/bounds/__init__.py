"""How much any policy can show in a world: upper bounds with certificates; see docs/bounds.md."""

from coopmap_env.evaluation.bounds.certificate import Certificate, PoseSets, ViewScores
from coopmap_env.evaluation.bounds.efficiency import Efficiency, efficiency, scans_in_time
from coopmap_env.evaluation.bounds.field_views import FieldViews
from coopmap_env.evaluation.bounds.jobs import WorldBound, bound_worlds
from coopmap_env.evaluation.bounds.planar_views import PlanarViews
from coopmap_env.evaluation.bounds.search import BoundSearch, ShownBound, bound_shown
from coopmap_env.evaluation.bounds.stored import (
    BoundFileError,
    check_bound,
    kept_bound,
    load_bound,
    save_bound,
)

__all__ = [
    "BoundFileError",
    "BoundSearch",
    "Certificate",
    "Efficiency",
    "FieldViews",
    "PlanarViews",
    "PoseSets",
    "ShownBound",
    "ViewScores",
    "WorldBound",
    "bound_shown",
    "bound_worlds",
    "check_bound",
    "efficiency",
    "kept_bound",
    "load_bound",
    "save_bound",
    "scans_in_time",
]
