"""One step of planar worlds, compiled: decode, move, rate, scan, fuse, reward, offer candidates.

`step_worlds` and `start_worlds` are all that changes a world. `PlanarEnv` calls them for its one
world, the vector environment for many.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, inlined_kernel, kernel
from coopmap_env.envs.planar._observation_kernels import (
    RatedCandidates,
    TeamObservations,
    name_observations,
    write_candidate_features,
    write_observations,
)
from coopmap_env.envs.planar._starts import list_known_cells, sample_start_poses
from coopmap_env.envs.planar._world_arrays import (
    StepConstants,
    StepResults,
    StepScratch,
    WorldArrays,
    name_constants,
    name_results,
    name_scratch,
    name_worlds,
)
from coopmap_env.envs.planar.actions import MASKED, requested_pose
from coopmap_env.envs.rewards import StepOutcome, write_reward_terms
from coopmap_env.information.planar.cell_codes import UNKNOWN, update_codes
from coopmap_env.information.planar.rating import lattice_distances, rate_poses
from coopmap_env.information.planar.views import evaluate_views, sequential_new_information
from coopmap_env.mapping import MapArrays, ScanGain, SurfaceArrays
from coopmap_env.mapping.integration import (
    apply_updates,
    clamp_log_odds,
    clear_surfaces,
    merge_points,
)
from coopmap_env.mapping.integration_fan import integrate_lattice_scan
from coopmap_env.mapping.integration_scalar import integrate_rays
from coopmap_env.robots import pose_from_id
from coopmap_env.robots.planar.feasible_poses import sample_feasible_poses
from coopmap_env.robots.planar.motion_time import lattice_motion_time
from coopmap_env.robots.planar.reachable_regions import (
    FEASIBLE,
    OUTSIDE_WORLD,
    RegionArrays,
    feasibility,
    label_regions,
    update_regions,
)
from coopmap_env.sensing import ScanArrays
from coopmap_env.simulation.planar_scans import scan_from_lattice
from coopmap_env.simulation.shown_cells import mark_planar_view

CLEARED_TOGETHER = 64
"""Cells."""
STAYS = -1
"""Target of a robot whose action is rejected."""


@inlined_kernel
def map_of(worlds: WorldArrays, e: int, constants: StepConstants) -> MapArrays:
    """The map of a world."""
    return MapArrays(
        worlds.log_odds_fixed[e], worlds.sampled_mask[e], constants.grid.shape, constants.clamp
    )


@inlined_kernel
def regions_of(worlds: WorldArrays, e: int, scratch: StepScratch) -> RegionArrays:
    """The regions that the team of a world reaches."""
    return RegionArrays(worlds.labels[e], worlds.access[e], worlds.n_labels[e], scratch.queue)


@inlined_kernel
def surfaces_of(worlds: WorldArrays, e: int) -> SurfaceArrays:
    """The surfaces in the map of a world."""
    kept = worlds.surfaces
    return SurfaceArrays(
        kept.precision[e], kept.information_vector[e], kept.noise[e], kept.scatter[e],
        kept.shared[e],
    )  # fmt: skip


@borrowing_kernel
def _decode(
    worlds: WorldArrays,
    e: int,
    actions: NDArray[np.float64],
    choices: NDArray[np.int64],
    constants: StepConstants,
    results: StepResults,
    scratch: StepScratch,
) -> None:
    """Write the target of each robot, and why its action is rejected."""
    n = constants.sampling.lattice.n_headings
    regions = regions_of(worlds, e, scratch)
    arrays = map_of(worlds, e, constants)
    for robot in range(worlds.pose_ids.shape[1]):
        pose_id, target, rejection = worlds.pose_ids[e, robot], STAYS, MASKED
        if worlds.candidates.shape[2] > 0:
            choice = choices[e, robot]
            if choice < worlds.n_candidates[e, robot]:
                target, rejection = worlds.candidates[e, robot, choice], FEASIBLE
        else:
            target = requested_pose(
                pose_id, actions[e, robot], constants.sampling.reach, constants.grid.shape,
                constants.sampling.lattice,
            )  # fmt: skip
            if target < 0:
                rejection = OUTSIDE_WORLD
            else:
                rejection = feasibility(arrays, regions, robot, pose_id // n, target // n)
        results.rejections[e, robot] = rejection
        scratch.targets[robot] = target if rejection == FEASIBLE else STAYS


@borrowing_kernel
def _move(
    worlds: WorldArrays,
    e: int,
    constants: StepConstants,
    results: StepResults,
    scratch: StepScratch,
) -> None:
    """Move the robots; a target that is truly occupied becomes a collision, and the robot stays.

    The targets become the executed poses. The team waits for the slowest motion, one that ended in
    a collision included, and then all scan.
    """
    lattice, slowest = constants.sampling.lattice, 0.0
    n = lattice.n_headings
    for robot in range(worlds.pose_ids.shape[1]):
        target = scratch.targets[robot]
        collides = target != STAYS and worlds.occupied[e, target // n]
        results.collided[e, robot] = collides
        scratch.start_ids[robot] = worlds.pose_ids[e, robot]
        if target != STAYS:
            start = worlds.pose_ids[e, robot]
            seconds = lattice_motion_time(start, target, n, lattice.ny, constants.speeds)
            slowest = max(slowest, seconds)
            if not collides:
                worlds.pose_ids[e, robot] = target
    worlds.elapsed[e] += slowest + constants.scan_time


@borrowing_kernel
def _rate(
    ids: NDArray[np.int64],
    start_ids: NDArray[np.int64],
    arrays: MapArrays,
    constants: StepConstants,
    scratch: StepScratch,
) -> None:
    """Write distance, cost, P and rating of poses whose new information is in the scratch."""
    k = len(ids)
    lattice, (alpha_position, alpha_heading) = constants.sampling.lattice, constants.alphas
    lattice_distances(
        ids, start_ids, lattice.n_headings, lattice.ny, lattice.resolution,
        alpha_position, alpha_heading, scratch.distance,
    )  # fmt: skip
    rate_poses(
        arrays.log_odds_fixed, constants.probability, constants.clamp, ids, lattice.n_headings,
        constants.cost_law, scratch.new_information[:k], scratch.distance[:k], scratch.ratings,
    )  # fmt: skip


@borrowing_kernel
def _mark_collisions(
    worlds: WorldArrays,
    e: int,
    constants: StepConstants,
    results: StepResults,
    scratch: StepScratch,
) -> int:
    """Mark the cells of collisions as occupied; return how many are now listed as touched."""
    n, count = constants.sampling.lattice.n_headings, 0
    for robot in range(worlds.pose_ids.shape[1]):
        if results.collided[e, robot]:
            cell = scratch.targets[robot] // n
            worlds.log_odds_fixed[e, cell] = constants.clamp
            worlds.n_observed[e] += 1 - worlds.sampled_mask[e, cell]
            worlds.sampled_mask[e, cell] = 1
            scratch.touched[count] = cell
            count += 1
    return count


@borrowing_kernel
def _fuse_scan(
    scan: ScanArrays,
    pose_id: int,
    arrays: MapArrays,
    surfaces: SurfaceArrays,
    constants: StepConstants,
    scratch: StepScratch,
) -> tuple[int, int, float]:
    """Fuse one scan; return how many cells it updated, how many were new, the entropy reduction."""
    n = constants.sampling.lattice.n_headings
    grid, beam, updates = constants.grid, constants.beam, scratch.updates
    if beam.partial_surface:
        count = integrate_rays(scan, grid, beam, scratch.beam, updates, scratch.hit_cells)
    else:
        count = integrate_lattice_scan(
            scan, pose_id // n, pose_id % n, constants.fan, scratch.free_beams, grid, beam,
            scratch.beam, updates, scratch.hit_cells,
        )  # fmt: skip
    cells = scratch.hit_cells  # a row for each cell
    merge_points(scan, cells, cells, grid, surfaces, scratch.beam.offset)
    new, reduction = apply_updates(count, beam, updates, arrays, constants.entropy)
    return count, new, reduction


@borrowing_kernel
def _mark_shown(
    worlds: WorldArrays, e: int, pose_id: int, constants: StepConstants, scratch: StepScratch
) -> int:
    """Mark what a scan truly shows; return how many cells no scan has shown before."""
    n, (nx, ny, _) = constants.sampling.lattice.n_headings, constants.grid.shape
    new = mark_planar_view(
        worlds.occupied[e], (nx, ny), pose_id // n, pose_id % n, constants.fan,
        scratch.shown_beams, scratch.shown_cells, worlds.shown_mask[e],
    )  # fmt: skip
    worlds.n_shown[e] += new
    return new


@borrowing_kernel
def _scan_and_fuse(
    worlds: WorldArrays,
    e: int,
    n_touched: int,
    constants: StepConstants,
    results: StepResults,
    scratch: StepScratch,
) -> int:
    """Scan with every robot and fuse; return how many cells are listed as touched."""
    nx, ny, _ = constants.grid.shape
    n = constants.sampling.lattice.n_headings
    arrays = map_of(worlds, e, constants)
    surfaces = surfaces_of(worlds, e)
    for robot in range(worlds.pose_ids.shape[1]):
        pose_id, pose = worlds.pose_ids[e, robot], scratch.poses[robot]
        pose[0], pose[1], pose[2] = pose_from_id(pose_id, constants.sampling.lattice)
        scan = ScanArrays(
            pose[:2], results.points[e, robot], results.covariances[e, robot],
            results.hit[e, robot],
        )  # fmt: skip
        scan_from_lattice(
            worlds.occupied[e], (nx, ny), constants.grid.resolution, pose_id // n, pose_id % n,
            pose, constants.fan, constants.camera, worlds.noise_streams[e], scan,
            scratch.free_beams,
        )  # fmt: skip
        count, new, reduction = _fuse_scan(scan, pose_id, arrays, surfaces, constants, scratch)
        for k in range(count):
            scratch.touched[n_touched + k] = scratch.updates.updated_cells[k]
        n_touched += count
        worlds.n_observed[e] += new
        results.new_cells[e, robot] = new
        results.entropy_reduction[e, robot] = reduction
        if worlds.shown_mask.shape[1] > 0:
            results.newly_shown[e, robot] = _mark_shown(worlds, e, pose_id, constants, scratch)
    clamp_log_odds(arrays.log_odds_fixed, scratch.touched[:n_touched], constants.clamp)
    update_codes(
        arrays.log_odds_fixed, arrays.sampled_mask, scratch.touched, n_touched,
        constants.code_of_log_odds, worlds.codes[e],
    )  # fmt: skip
    worlds.n_scans[e] += 1
    return n_touched


@borrowing_kernel
def _write_rewards(e: int, constants: StepConstants, results: StepResults) -> None:
    """Write the reward terms of each robot, and the reward that it gets."""
    n_robots, scale = results.rewards.shape[1], constants.reward_scale
    total = 0.0
    for robot in range(n_robots):
        outcome = StepOutcome(
            results.new_information[e, robot],
            results.distance[e, robot],
            results.motion_cost[e, robot],
            results.rating[e, robot],
            ScanGain(results.new_cells[e, robot], results.entropy_reduction[e, robot]),
            0.0,
            results.newly_shown[e, robot],
        )
        terms = results.reward_terms[e, robot]
        write_reward_terms(outcome, scale, terms)
        results.rewards[e, robot] = terms[constants.reward_term]
        total += results.rewards[e, robot]
    if constants.is_reward_shared:
        for robot in range(n_robots):
            results.rewards[e, robot] = total / n_robots


@borrowing_kernel
def _offer_candidates(
    worlds: WorldArrays, e: int, constants: StepConstants, scratch: StepScratch
) -> None:
    """Draw the candidates of each robot."""
    regions = regions_of(worlds, e, scratch)
    for robot in range(worlds.pose_ids.shape[1]):
        worlds.n_candidates[e, robot] = sample_feasible_poses(
            worlds.pose_ids[e, robot], robot, constants.sampling, regions,
            worlds.candidate_streams[e], scratch.picked, worlds.candidates[e, robot],
        )  # fmt: skip


@borrowing_kernel
def _describe_candidates(
    worlds: WorldArrays,
    e: int,
    constants: StepConstants,
    observations: TeamObservations,
    scratch: StepScratch,
) -> None:
    """Write the features and the masks of all candidates."""
    arrays, k = map_of(worlds, e, constants), 0
    for robot in range(worlds.pose_ids.shape[1]):
        for i in range(worlds.n_candidates[e, robot]):
            scratch.candidate_ids[k] = worlds.candidates[e, robot, i]
            scratch.start_ids[k] = worlds.pose_ids[e, robot]
            k += 1
    ids, starts = scratch.candidate_ids[:k], scratch.start_ids[:k]
    nx, ny, _ = constants.grid.shape
    evaluate_views(
        worlds.codes[e], (nx, ny), ids, constants.fan, constants.views, scratch.view_buffers,
        scratch.new_information, scratch.unknown,
    )  # fmt: skip
    _rate(ids, starts, arrays, constants, scratch)
    observations.features[e] = 0.0
    observations.action_mask[e] = 0
    rated = RatedCandidates(
        scratch.new_information, scratch.ratings[0], scratch.ratings[1], scratch.ratings[2],
        scratch.unknown,
    )  # fmt: skip
    write_candidate_features(
        ids, worlds.n_candidates[e], scratch.poses, constants.sampling.lattice, rated,
        constants.feature_scale, observations.features[e], observations.action_mask[e],
    )  # fmt: skip


@borrowing_kernel
def _observe(
    worlds: WorldArrays,
    e: int,
    constants: StepConstants,
    observations: TeamObservations,
    scratch: StepScratch,
) -> None:
    """Offer new candidates and write what every robot observes."""
    n_robots = worlds.pose_ids.shape[1]
    for robot in range(n_robots):
        pose = scratch.poses[robot]
        pose[0], pose[1], pose[2] = pose_from_id(
            worlds.pose_ids[e, robot], constants.sampling.lattice
        )
    views = observations.views
    write_observations(
        map_of(worlds, e, constants), constants.extent, constants.crop, worlds.pose_ids[e],
        scratch.poses, views.maps[e], views.pose_vectors[e], views.teammates[e],
    )  # fmt: skip
    if worlds.candidates.shape[2] > 0:
        _offer_candidates(worlds, e, constants, scratch)
        _describe_candidates(worlds, e, constants, observations, scratch)


@borrowing_kernel
def _step_world(
    worlds: WorldArrays,
    e: int,
    actions: NDArray[np.float64],
    choices: NDArray[np.int64],
    constants: StepConstants,
    results: StepResults,
    observations: TeamObservations,
    scratch: StepScratch,
) -> None:
    n_robots, n = worlds.pose_ids.shape[1], constants.sampling.lattice.n_headings
    arrays = map_of(worlds, e, constants)
    _decode(worlds, e, actions, choices, constants, results, scratch)
    _move(worlds, e, constants, results, scratch)
    pose_ids = worlds.pose_ids[e]
    nx, ny, _ = constants.grid.shape
    sequential_new_information(
        worlds.codes[e], (nx, ny), pose_ids, constants.fan, constants.views, scratch.view_buffers,
        scratch.reserved, scratch.new_information,
    )  # fmt: skip
    _rate(pose_ids, scratch.start_ids[:n_robots], arrays, constants, scratch)
    for robot in range(n_robots):
        results.new_information[e, robot] = scratch.new_information[robot]
        results.distance[e, robot] = scratch.distance[robot]
        results.motion_cost[e, robot] = scratch.ratings[0, robot]
        results.rating[e, robot] = scratch.ratings[2, robot]
    n_touched = _mark_collisions(worlds, e, constants, results, scratch)
    n_touched = _scan_and_fuse(worlds, e, n_touched, constants, results, scratch)
    _write_rewards(e, constants, results)
    regions = regions_of(worlds, e, scratch)
    update_regions(arrays, scratch.touched, n_touched, pose_ids, n, regions)
    _observe(worlds, e, constants, observations, scratch)


@kernel
def step_worlds(
    which: NDArray[np.int64],
    actions: NDArray[np.float64],
    choices: NDArray[np.int64],
    worlds_tuple: PlainTuple,
    constants_tuple: PlainTuple,
    results_tuple: PlainTuple,
    observations_tuple: PlainTuple,
    scratch_tuple: PlainTuple,
) -> None:
    """Step some worlds, given by their numbers.

    `actions` (E, N, 3) are "pose" actions, `choices` (E, N) indices of candidates, of all worlds;
    the mode that is not used has none. All are valid. The tuples are plain `WorldArrays`,
    `StepConstants`, `StepResults`, `TeamObservations` and `StepScratch`.
    """
    worlds, constants = name_worlds(worlds_tuple), name_constants(constants_tuple)
    results, observations = name_results(results_tuple), name_observations(observations_tuple)
    scratch = name_scratch(scratch_tuple)
    for e in which:
        _step_world(worlds, e, actions, choices, constants, results, observations, scratch)


@borrowing_kernel
def _empty_map(worlds: WorldArrays, e: int) -> None:
    """Forget all cells that are sampled, or were before the map was cleared by hand.

    There is nothing to forget of others. Most groups of cells hold none, and it is much faster to
    read two small arrays than to write all.
    """
    sampled, codes, surfaces = worlds.sampled_mask[e], worlds.codes[e], surfaces_of(worlds, e)
    for first in range(0, len(sampled), CLEARED_TOGETHER):
        stop, anything = min(first + CLEARED_TOGETHER, len(sampled)), np.uint8(0)
        for cell in range(np.uint64(first), np.uint64(stop)):
            anything = np.uint8(anything | sampled[cell] | codes[cell])
        if anything:
            worlds.log_odds_fixed[e, first:stop] = 0
            codes[first:stop] = UNKNOWN
            worlds.labels[e, first:stop] = 0
            clear_surfaces(surfaces, first, stop)
            sampled[first:stop] = 0
    worlds.n_labels[e] = worlds.n_observed[e] = worlds.n_scans[e] = 0
    worlds.elapsed[e] = 0.0


@borrowing_kernel
def _start_world(
    worlds: WorldArrays, e: int, constants: StepConstants, scratch: StepScratch
) -> None:
    """Empty the map, place the team, and mark the cells around it that are known to be free."""
    nx, ny, _ = constants.grid.shape
    log_odds, sampled, codes = worlds.log_odds_fixed[e], worlds.sampled_mask[e], worlds.codes[e]
    occupied, pose_ids = worlds.occupied[e].reshape(nx, ny), worlds.pose_ids[e]
    _empty_map(worlds, e)
    start = constants.start
    sample_start_poses(occupied, start, worlds.start_streams[e], scratch.start, pose_ids)
    for robot in range(len(pose_ids)):
        n_known = list_known_cells(
            occupied, pose_ids[robot] // start.n_headings, start.known_radius, scratch.start
        )
        for cell in scratch.start.cells[:n_known]:
            worlds.n_observed[e] += 1 - sampled[cell]
            log_odds[cell], sampled[cell] = -constants.clamp, 1
            codes[cell] = constants.code_of_log_odds[0]
    if worlds.shown_mask.shape[1] > 0:
        for cell in range(len(sampled)):
            worlds.shown_mask[e, cell] = sampled[cell]
        worlds.n_shown[e] = worlds.n_observed[e]
    arrays, regions = map_of(worlds, e, constants), regions_of(worlds, e, scratch)
    label_regions(arrays, pose_ids, start.n_headings, regions)


@kernel
def start_worlds(
    which: NDArray[np.int64],
    worlds_tuple: PlainTuple,
    constants_tuple: PlainTuple,
    scratch_tuple: PlainTuple,
) -> None:
    """Start an episode in some worlds whose truths and random numbers are set.

    The tuples are plain, as of `step_worlds`.
    """
    worlds, constants = name_worlds(worlds_tuple), name_constants(constants_tuple)
    scratch = name_scratch(scratch_tuple)
    for e in which:
        _start_world(worlds, e, constants, scratch)


@kernel
def observe_worlds(
    which: NDArray[np.int64],
    worlds_tuple: PlainTuple,
    constants_tuple: PlainTuple,
    observations_tuple: PlainTuple,
    scratch_tuple: PlainTuple,
) -> None:
    """Offer candidates to the teams of some worlds that started, and observe.

    The tuples are plain, as of `step_worlds`.
    """
    worlds, constants = name_worlds(worlds_tuple), name_constants(constants_tuple)
    observations, scratch = name_observations(observations_tuple), name_scratch(scratch_tuple)
    for e in which:
        _observe(worlds, e, constants, observations, scratch)
