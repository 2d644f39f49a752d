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

from coopmap_env.geometry import rotation_about_z
from coopmap_env.geometry.transforms import Pose
from coopmap_env.localization.registration.branch_and_bound import (
    best_first_search,
    hill_climb,
    points_to_cells,
)
from coopmap_env.localization.registration.likelihood_field import likelihood_field
from coopmap_env.localization.registration.views import ViewBatch
from coopmap_env.localization.target import TargetModel

_REFINEMENTS = ((0.5, 0.75), (0.25, 0.5))
"""Shares of a step and a yaw step by which found hypotheses are moved to the best pose near to
them, and the shares of the field's width that go with them: in this order."""
_GOLDEN = 0.618033988749895
"""Multiples of it, less whole numbers, are spread evenly."""
_DUPLICATE_TOLERANCE = np.array([0.06, 0.06, 0.04])
"""Metres and radians within which two hypotheses have climbed to the same top."""
_MAX_VISITS = 24_000
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

    min_distance: float = 2.0
    """Metres between the base and the target's middle at least."""
    max_distance: float = 5.2
    """Metres at most: vehicles stand 2.5 to 4.5 m away."""
    xy_step: float = 0.1
    """Metres between neighbouring poses: refinement finds its way from twice as far."""
    yaw_step: float = math.radians(5.0)
    """Radians: moves what lies 1.2 m from the target's middle by a step."""
    n_levels: int = 3
    """Halvings from the largest cells, of 0.8 m, to a step."""
    field_sigma: float = 0.08
    """Metres, sigma of the likelihood field: a point is off by half a step, half a yaw step and
    3 cm of range noise and of the camera's pose."""
    ground_height: float = 0.15
    """Metres above the ground below which points are its own: three sigma of their height."""
    voxel_size: float = 0.1
    """Metres: one vote for each voxel with points, so that what is near has no more weight."""
    max_points: int = 300
    """At most; of more, every so manieth counts for its neighbours."""
    seen_through_margin: float = 0.2
    """Metres by which a beam must pass a surface to see through: three sigma of range at 5 m and
    a step."""
    seen_through_weight: float = 1.0
    """Weight of a square metre seen through against one that is seen. Of closed bodies both
    sides are seen through at once; that much doubt is right."""
    n_probes: int = 300
    """Points of the surface that beams are tested against."""
    min_separation: tuple[float, float] = (0.3, math.radians(15.0))
    """Metres and radians within which two hypotheses are the same."""
    min_score: float = 15.0
    """Votes below which nothing is a hypothesis: 0.15 square metres of surface."""
    min_relative_score: float = 0.5
    """Of the best score, below which nothing is one."""
    max_hypotheses: int = 32
    """Hypotheses at most."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            low = 1 if field.name in ("n_probes", "max_hypotheses", "n_levels", "max_points") else 0
            least = min(value) if field.name == "min_separation" else value
            if not (math.isfinite(least) and least >= low):
                raise ValueError(f"SearchSettings.{field.name} must be >= {low}, got {value}")
        for name in ("xy_step", "yaw_step", "field_sigma", "voxel_size"):
            if not getattr(self, name) > 0:
                raise ValueError(f"SearchSettings.{name} must be > 0, got {getattr(self, name)}")
        if not self.min_distance < self.max_distance:
            raise ValueError(
                f"SearchSettings needs min_distance < max_distance, got {self.min_distance} and {self.max_distance} m"
            )


class PoseHypothesis(NamedTuple):
    """A pose that the target could have."""

    T_target_base: Pose
    score: float
    """Votes for it less those against."""


def search(model: TargetModel, batch: ViewBatch, settings: SearchSettings) -> list[PoseHypothesis]:
    """The best distinct hypotheses of where the base stands, the best first; maybe none.

    Parameters
    ----------
    model : TargetModel
    looks : ViewBatch
        At least one look.
    settings : SearchSettings
    """
    field = likelihood_field(model, settings.xy_step, settings.field_sigma, settings.n_levels)
    points = voxel_centroids(
        batch.points_in_base(), settings.ground_height, model.bounds[1, 2], settings.voxel_size
    )
    reach = settings.max_distance + np.linalg.norm(model.bounds[1] - model.bounds[0]) / 2
    points = points[np.hypot(points[:, 0], points[:, 1]) < reach]
    if not len(points):
        return []
    stride = math.ceil(len(points) / settings.max_points)
    points = points[::stride]
    n_yaws = max(round(2.0 * math.pi / settings.yaw_step), 1)
    yaws = np.arange(n_yaws) * (2.0 * math.pi / n_yaws)
    n_steps = math.ceil(2.0 * settings.max_distance / settings.xy_step)
    corner = model.center_xy - settings.max_distance
    probes = model.sample_surface(settings.n_probes)[0]
    # from all over the target in turn: a few of them tell of most poses that they are wrong
    probes = probes[np.argsort(np.arange(len(probes)) * _GOLDEN % 1.0)]
    probe_weight = (
        settings.seen_through_weight
        * model.area
        / settings.n_probes
        / settings.voxel_size**2
        / stride
    )
    found, scores = best_first_search(
        points_to_cells(points, yaws, corner, field.origin, field.cell), field.pooled,
        n_steps, corner, settings.xy_step, model.center_xy, (settings.min_distance, settings.max_distance), yaws,
        probes, batch.min_ranges, batch.R, batch.t, batch.intrinsics, settings.seen_through_margin, probe_weight,
        settings.min_separation, settings.min_score / stride, settings.min_relative_score, settings.max_hypotheses, _MAX_VISITS,
    )  # fmt: skip
    for step_fraction, sigma_fraction in _REFINEMENTS:
        fine = likelihood_field(
            model, settings.xy_step / 2.0, settings.field_sigma * sigma_fraction, 0
        )
        hill_climb(
            found, scores, points, fine.pooled[0], fine.origin, fine.cell, settings.xy_step * step_fraction,
            settings.yaw_step * step_fraction, probes, batch.min_ranges, batch.R, batch.t, batch.intrinsics,
            settings.seen_through_margin, probe_weight,
        )  # fmt: skip
    best = np.argsort(-scores, kind="stable")
    best = best[scores[best] >= settings.min_relative_score * scores.max(initial=0.0)]
    return [
        PoseHypothesis(
            Pose(np.array([*found[k, :2], 0.0]), rotation_about_z(found[k, 2])), stride * scores[k]
        )
        for k in _without_duplicates(found, best)
    ]


def _without_duplicates(found: NDArray[np.float64], order: NDArray[np.int64]) -> list[int]:
    """Those that are not the same as one before them: a tenth of a step is what `hill_climb` tells."""
    kept: list[int] = []
    for k in order.tolist():
        differences = np.abs(found[kept] - found[k])
        differences[:, 2] = np.abs(
            np.remainder(differences[:, 2] + math.pi, 2.0 * math.pi) - math.pi
        )
        if not (differences < _DUPLICATE_TOLERANCE).all(axis=1).any():
            kept.append(k)
    return kept


def voxel_centroids(
    points: NDArray[np.float64], ground_height: float, top: float, voxel_size: float
) -> NDArray[np.float64]:
    """The middles of the points of each voxel (k, 3), of points (n, 3) over the ground.

    What is more than two voxels higher than the target's top is left out, as no hypothesis has a
    use for it.
    """
    points = points[(points[:, 2] > ground_height) & (points[:, 2] < top + 2.0 * voxel_size)]
    if not len(points):
        return points
    cells = np.floor(points / voxel_size).astype(np.int64)
    cells -= cells.min(axis=0)
    size = cells.max(axis=0) + 1
    keys = (cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2]
    _, of, counts = np.unique(keys, return_inverse=True, return_counts=True)
    sums = [np.bincount(of, weights=points[:, i]) for i in range(3)]
    return np.stack(sums, axis=1) / counts[:, None]
