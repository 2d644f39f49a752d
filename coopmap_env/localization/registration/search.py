"""Search for the target: x, y and yaw of the base poses that explain most points.

A correlative search (Olson 2009) on a likelihood field of the target, by branch and bound on
max-pooled fields (Hess et al. 2016). Rays count too: where a ray passes there is no surface. So a
hypothesis scores

    points on the target, a vote each  -  weight * surface seen through, in votes

and points elsewhere cost nothing: most of a scene is not the target. Nodes of the tree are visited
best first. The bound of a node leaves out the rays, whose term is never above 0, so the hypotheses
come out in the order of their scores, and the search ends with as many as requested.

The base frame and the target's are assumed to be upright on the same flat ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import length
from coopmap_env.core.settings import Bounds, NonNegative, Settings
from coopmap_env.geometry import Pose, rotation_about_z
from coopmap_env.localization.registration._branch_and_bound import (
    Probes,
    SearchGrid,
    SearchLimits,
    best_first_search,
    hill_climb,
    points_to_cells,
)
from coopmap_env.localization.registration._likelihood_field import likelihood_field
from coopmap_env.localization.registration.views import ViewBatch
from coopmap_env.localization.target import TargetModel

_REFINEMENTS = ((0.5, 0.75), (0.25, 0.5))
"""Passes of `hill_climb`: fractions of the steps in x, y and yaw, and of the field's sigma."""
_GOLDEN = 0.618033988749895
"""Golden ratio: fractional parts of its multiples are spread evenly."""
_DUPLICATE_TOLERANCE = np.array([0.06, 0.06, 0.04])
"""Metres and radians within which two hypotheses have climbed to the same maximum."""


@dataclass(frozen=True)
class SearchSettings(Settings):
    """What is searched, how finely, and what counts."""

    min_distance: NonNegative = 2.0
    """Least distance between the base and the target's center, metres."""
    max_distance: Annotated[float, Bounds(at_least=0, largest=100)] = 5.2
    """Largest distance, metres: vehicles stand 2.5 to 4.5 m away."""
    xy_step: Annotated[float, Bounds(above=0, smallest=0.001, largest=10)] = 0.1
    """Metres between neighbouring poses: the alignment converges from twice as far."""
    yaw_step: Annotated[float, Bounds(above=0, smallest=0.001, largest=math.pi)] = math.radians(5.0)
    """Radians: moves what lies 1.2 m from the target's center by a step."""
    n_levels: Annotated[int, Bounds(at_least=1, largest=8)] = 3
    """Halvings from the largest cells, of 0.8 m, to a step."""
    field_sigma: Annotated[float, Bounds(above=0, largest=10)] = 0.08
    """Sigma of the likelihood field, metres: a point is off by half a step, half a yaw step and
    3 cm of range noise and of the camera's pose."""
    ground_height: NonNegative = 0.15
    """Metres above the ground below which points are the ground's: three sigma of their height."""
    voxel_size: Annotated[float, Bounds(above=0, smallest=0.001)] = 0.1
    """Metres. Each voxel with points has one vote, so near surfaces have no more weight."""
    max_points: Annotated[int, Bounds(at_least=1, largest=100_000)] = 300
    """Votes that are evaluated; of more, every k-th stands for its neighbours."""
    seen_through_margin: NonNegative = 0.2
    """Metres by which a ray must pass a surface to see through it: three sigma of range at 5 m
    and a step."""
    seen_through_weight: NonNegative = 1.0
    """Weight of a square metre seen through, in square metres that are seen. Of closed bodies both
    sides are seen through at once."""
    n_probes: Annotated[int, Bounds(at_least=1, largest=100_000)] = 300
    """Points of the surface that rays are tested against."""
    min_separation: tuple[NonNegative, NonNegative] = (0.3, math.radians(15.0))
    """Metres and radians within which two hypotheses are the same."""
    min_score: NonNegative = 15.0
    """Votes of a hypothesis: 0.15 square metres of surface."""
    min_relative_score: NonNegative = 0.5
    """Score of a hypothesis as a fraction of the best one."""
    max_hypotheses: Annotated[int, Bounds(at_least=1, largest=10_000)] = 32
    """Hypotheses that are returned."""
    max_visits: Annotated[int, Bounds(at_least=1, largest=10_000_000)] = 24_000
    """Nodes of a search: about 0.15 s. A worksite needs some hundreds to a few thousand. In dense
    rubble the search may end here, and the robot needs more scans."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.min_distance < self.max_distance:
            raise ValueError(
                "SearchSettings needs min_distance < max_distance, got "
                f"{self.min_distance} and {self.max_distance} m"
            )


class PoseHypothesis(NamedTuple):
    """A possible pose of the base."""

    T_target_base: Pose
    score: float
    """Votes for it, less those against it."""


def search(model: TargetModel, batch: ViewBatch, settings: SearchSettings) -> list[PoseHypothesis]:
    """The best distinct hypotheses of the base's pose, best first; empty if there is none.

    Parameters
    ----------
    model : TargetModel
    batch : ViewBatch
        At least one view.
    settings : SearchSettings
    """
    s = settings
    points = voxel_centroids(
        batch.points_in_base(), s.ground_height, model.bounds[1, 2], s.voxel_size
    )
    reach = s.max_distance + length(model.bounds[1] - model.bounds[0]) / 2
    points = points[np.linalg.norm(points[:, :2], axis=1) < reach]
    if not len(points):
        return []
    stride = math.ceil(len(points) / s.max_points)
    points = points[::stride]
    probes = Probes(
        _surface_probes(model, s.n_probes),
        s.seen_through_weight * model.area / s.n_probes / s.voxel_size**2 / stride,
    )
    beams = batch.beams(s.seen_through_margin)
    grid = _search_grid(model, s)
    limits = SearchLimits(
        s.min_separation, s.min_score / stride, s.min_relative_score, s.max_hypotheses, s.max_visits
    )
    field = likelihood_field(model, s.xy_step, s.field_sigma, s.n_levels)
    cells = points_to_cells(points, grid, field.finest)
    found, scores = best_first_search(cells, field.pooled, grid, probes, beams, limits)
    for step_fraction, sigma_fraction in _REFINEMENTS:
        fine = likelihood_field(model, s.xy_step / 2.0, s.field_sigma * sigma_fraction, 0)
        steps = s.xy_step * step_fraction, s.yaw_step * step_fraction
        hill_climb(found, scores, points, fine.finest, steps, probes, beams)
    best = np.argsort(-scores, kind="stable")
    best = best[scores[best] >= s.min_relative_score * scores.max(initial=0.0)]
    return [
        PoseHypothesis(
            Pose(np.array([*found[k, :2], 0.0]), rotation_about_z(found[k, 2])), stride * scores[k]
        )
        for k in _without_duplicates(found, best)
    ]


def _search_grid(model: TargetModel, settings: SearchSettings) -> SearchGrid:
    n_yaws = max(round(2.0 * math.pi / settings.yaw_step), 1)
    return SearchGrid(
        math.ceil(2.0 * settings.max_distance / settings.xy_step),
        model.center_xy - settings.max_distance,
        settings.xy_step,
        np.arange(n_yaws, dtype=np.float64) * (2.0 * math.pi / n_yaws),
        model.center_xy,
        settings.min_distance,
        settings.max_distance,
    )


def _surface_probes(model: TargetModel, n: int) -> NDArray[np.float64]:
    """Points (n, 3) of the surface, in an order in which a few already cover all of it.

    So most wrong poses are rejected after a few probes.
    """
    probes = model.sample_surface(n)[0]
    return np.asarray(probes[np.argsort(np.arange(len(probes)) * _GOLDEN % 1.0)])


def _without_duplicates(found: NDArray[np.float64], order: NDArray[np.int64]) -> list[int]:
    """Hypotheses in an order, without those that have climbed to the maximum of an earlier one."""
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
    """Centroids (k, 3) of the points (n, 3) in each voxel, metres.

    Points below the ground height, or more than two voxels above the target's top, are left out.
    """
    points = points[(points[:, 2] > ground_height) & (points[:, 2] < top + 2.0 * voxel_size)]
    if not len(points):
        return points
    cells = np.floor(points / voxel_size).astype(np.int64)
    cells -= cells.min(axis=0)
    size = cells.max(axis=0) + 1
    keys = (cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2]
    _, voxel, counts = np.unique(keys, return_inverse=True, return_counts=True)
    sums = [np.bincount(voxel, weights=points[:, i]) for i in range(3)]
    return np.stack(sums, axis=1) / counts[:, None]
