"""Where could a target stand? A search of x, y and yaw for the poses that explain most points.

A correlative search (Olson 2009) on a likelihood field of the target, by branch and bound on
max-pooled fields (Hess et al. 2016). Beams count too: a surface through which a beam passes is not
there. So a hypothesis scores

    points on the target, a vote each  -  weight * surface seen through, in votes

and points that lie elsewhere cost nothing: most of a scene is not the target. Nodes of the tree are
visited best first. The bound of a node leaves out the beams, whose share is never above 0, so that
the hypotheses come out in the order of their scores, and the search ends with as many as asked for.

It is assumed that the base frame and the target's stand upright on the same flat ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry.transforms import Pose
from coopmap_env.localization.registration.branch_and_bound import best_first, cells_of, climb
from coopmap_env.localization.registration.likelihood_field import likelihood_field
from coopmap_env.localization.registration.views import Looks
from coopmap_env.localization.target import TargetModel, about_z

_FINER = ((0.5, 0.75), (0.25, 0.5))
"""Shares of a step and a yaw step by which found hypotheses are moved to the best pose near to
them, and the shares of the field's width that go with them: in this order."""
_GOLDEN = 0.618033988749895
"""Multiples of it, less whole numbers, are spread evenly."""
_SAME = np.array([0.06, 0.06, 0.04])
"""Metres and radians within which two hypotheses have climbed to the same top."""
_MOST_VISITS = 24_000
"""Nodes of a search at most: about 0.15 s. A worksite needs some hundreds to a few thousand; in
dense rubble the search may end here, and the robot has to look once more."""


@dataclass(frozen=True)
class SearchSettings:
    """What is searched, how finely, and what counts.

    Raises
    ------
    ValueError
        With the value, if one is out of range.
    """

    nearest: float = 2.0
    """Metres between the base and the target's middle at least."""
    farthest: float = 5.2
    """Metres at most: vehicles stand 2.5 to 4.5 m away."""
    step: float = 0.1
    """Metres between neighbouring poses: refinement finds its way from twice as far."""
    yaw_step: float = math.radians(5.0)
    """Radians: moves what lies 1.2 m from the target's middle by a step."""
    levels: int = 3
    """Halvings from the largest cells, of 0.8 m, to a step."""
    width: float = 0.08
    """Metres, sigma of the likelihood field: a point is off by half a step, half a yaw step and
    3 cm of range noise and of the camera's pose."""
    ground: float = 0.15
    """Metres above the ground below which points are its own: three sigma of their height."""
    voxel: float = 0.1
    """Metres: one vote for each voxel with points, so that what is near has no more weight."""
    votes: int = 300
    """At most; of more, every so manieth counts for its neighbours."""
    margin: float = 0.2
    """Metres by which a beam must pass a surface to see through: three sigma of range at 5 m and
    a step."""
    seen_through: float = 1.0
    """Weight of a square metre seen through against one that is seen. Of closed bodies both
    sides are seen through at once; that much doubt is right."""
    probes: int = 300
    """Points of the surface that beams are tested against."""
    distinct: tuple[float, float] = (0.3, math.radians(15.0))
    """Metres and radians within which two hypotheses are the same."""
    least: float = 15.0
    """Votes below which nothing is a hypothesis: 0.15 square metres of surface."""
    share: float = 0.5
    """Of the best score, below which nothing is one."""
    count: int = 32
    """Hypotheses at most."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            low = 1 if field.name in ("probes", "count", "levels", "votes") else 0
            least = min(value) if field.name == "distinct" else value
            if not (math.isfinite(least) and least >= low):
                raise ValueError(f"SearchSettings.{field.name} must be >= {low}, got {value}")
        for name in ("step", "yaw_step", "width", "voxel"):
            if not getattr(self, name) > 0:
                raise ValueError(f"SearchSettings.{name} must be > 0, got {getattr(self, name)}")
        if not self.nearest < self.farthest:
            raise ValueError(
                f"SearchSettings needs nearest < farthest, got {self.nearest} and {self.farthest} m"
            )


class Hypothesis(NamedTuple):
    """A pose that the target could have."""

    T_target_base: Pose
    score: float
    """Votes for it less those against."""


def search(model: TargetModel, looks: Looks, settings: SearchSettings) -> list[Hypothesis]:
    """The best distinct hypotheses of where the base stands, the best first; maybe none.

    Parameters
    ----------
    model : TargetModel
    looks : Looks
        At least one look.
    settings : SearchSettings
    """
    field = likelihood_field(model, settings.step, settings.width, settings.levels)
    points = votes(looks.in_base(), settings.ground, model.bounds[1, 2], settings.voxel)
    reach = settings.farthest + np.linalg.norm(model.bounds[1] - model.bounds[0]) / 2
    points = points[np.hypot(points[:, 0], points[:, 1]) < reach]
    if not len(points):
        return []
    each = math.ceil(len(points) / settings.votes)
    points = points[::each]
    n_yaws = max(round(2.0 * math.pi / settings.yaw_step), 1)
    yaws = np.arange(n_yaws) * (2.0 * math.pi / n_yaws)
    n_steps = math.ceil(2.0 * settings.farthest / settings.step)
    corner = model.middle - settings.farthest
    probes = model.sampled(settings.probes)[0]
    # from all over the target in turn: a few of them tell of most poses that they are wrong
    probes = probes[np.argsort(np.arange(len(probes)) * _GOLDEN % 1.0)]
    weight = settings.seen_through * model.area / settings.probes / settings.voxel**2 / each
    found, scores = best_first(
        cells_of(points, yaws, corner, field.origin, field.cell), field.levels,
        n_steps, corner, settings.step, model.middle, (settings.nearest, settings.farthest), yaws,
        probes, looks.around, looks.R, looks.t, looks.lens, settings.margin, weight,
        settings.distinct, settings.least / each, settings.share, settings.count, _MOST_VISITS,
    )  # fmt: skip
    for share, narrower in _FINER:
        fine = likelihood_field(model, settings.step / 2.0, settings.width * narrower, 0)
        climb(
            found, scores, points, fine.levels[0], fine.origin, fine.cell, settings.step * share,
            settings.yaw_step * share, probes, looks.around, looks.R, looks.t, looks.lens,
            settings.margin, weight,
        )  # fmt: skip
    best = np.argsort(-scores, kind="stable")
    best = best[scores[best] >= settings.share * scores.max(initial=0.0)]
    return [
        Hypothesis(Pose(np.array([*found[k, :2], 0.0]), about_z(found[k, 2])), each * scores[k])
        for k in _apart(found, best)
    ]


def _apart(found: NDArray[np.float64], order: NDArray[np.int64]) -> list[int]:
    """Those that are not the same as one before them: a tenth of a step is what `climb` tells."""
    kept: list[int] = []
    for k in order.tolist():
        away = np.abs(found[kept] - found[k])
        away[:, 2] = np.abs(np.remainder(away[:, 2] + math.pi, 2.0 * math.pi) - math.pi)
        if not (away < _SAME).all(axis=1).any():
            kept.append(k)
    return kept


def votes(
    points: NDArray[np.float64], ground: float, top: float, voxel: float
) -> NDArray[np.float64]:
    """The middles of the points of each voxel (k, 3), of points (n, 3) over the ground.

    What is more than two voxels higher than the target's top is left out, as no hypothesis has a
    use for it.
    """
    points = points[(points[:, 2] > ground) & (points[:, 2] < top + 2.0 * voxel)]
    if not len(points):
        return points
    cells = np.floor(points / voxel).astype(np.int64)
    cells -= cells.min(axis=0)
    size = cells.max(axis=0) + 1
    keys = (cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2]
    _, of, counts = np.unique(keys, return_inverse=True, return_counts=True)
    sums = [np.bincount(of, weights=points[:, i]) for i in range(3)]
    return np.stack(sums, axis=1) / counts[:, None]
