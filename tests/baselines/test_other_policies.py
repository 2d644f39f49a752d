"""What each of the other reference planners says of itself."""

import itertools
import math

import numpy as np
import pytest
from plain.planar_worlds import (
    NO_NOISE,
    env_with_world,
    open_world,
    pose_id,
    set_poses,
    world_from_text,
)
from plain.random_maps import random_map, set_cells
from plain.views import visible_cells

import coopmap_baselines
from coopmap_baselines.frontier import FrontierPolicy
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.information import PlanarMutualInformation, adjacent_to_unknown
from coopmap_env.robots import ReachableCells
from coopmap_env.sensing import PlanarCamera

SETTINGS = PlanarSettings(noise=NO_NOISE)


def chosen(policy, belief, robot=0):
    """Pose number of a robot's action."""
    agent = belief.agents[robot]
    pose, reason = belief.actions.decode(agent, policy.act(belief, {})[agent], belief)
    assert reason == 0
    return pose


def write_random_map(env, rng):
    """Random knowledge around a robot that stands on a free cell; return the belief."""
    belief = set_poses(env, (20, 20, int(rng.integers(16))))
    known = random_map(rng, (40, 40), unknown=0.15, occupied=0.1)
    belief.map.log_odds_fixed[:], belief.map.sampled_mask[:] = (
        known.log_odds_fixed,
        known.sampled_mask,
    )
    belief.map.mark_free([20 * 40 + 20])
    return belief


# frontier


def test_frontier_goes_to_the_nearest_frontier_by_path_not_as_the_crow_flies():
    # '#' is known to be occupied, '.' to be free; beyond the drawing all is unknown.
    drawing = """
        #################
        #...............#
        #.#############.#
        #.#...........#.#
        #.#...........#.#
        #.#...........#.#
        #.#...........#.#
        #.............#.#
        #.#############.#
        #.#...........#.#
        #.#...........#.#
        #.#...........#.#
        #.#############.#
        #...............#
        #################
    """
    drawn = world_from_text(drawing).occupied
    env = env_with_world(open_world(), n_robots=1, settings=SETTINGS)
    belief = set_poses(env, (16, 17, 0))

    def know(unknown):
        belief.map.clear()
        for (i, j), wall in np.ndenumerate(drawn):
            set_cells(belief.map, [(10 + i) * 40 + 10 + j], 0.99 if wall else 0.01)
        for i, j in unknown:
            belief.map.log_odds_fixed[(10 + i) * 40 + 10 + j] = 0
            belief.map.sampled_mask[(10 + i) * 40 + 10 + j] = 0

    # (6, 7) is the robot's drawing cell; the room below it ends at a wall of row 6.
    know(unknown=[(6, 5), (13, 7)])  # 2 below, but behind a wall; and 7 to the right, in the open
    cell = chosen(FrontierPolicy("nearest"), belief) // 16
    assert divmod(cell, 40) == (22, 17)


def test_frontier_takes_the_first_cell_by_path_from_which_the_unknown_shows():
    env = env_with_world(open_world(), n_robots=1, settings=SETTINGS)
    rng, seen = np.random.default_rng(0), 0
    for _ in range(30):
        belief = write_random_map(env, rng)
        map_, pose = belief.map, chosen(FrontierPolicy("nearest"), belief)
        steps = ReachableCells.search(map_, belief.cell(0)).steps
        unknown = np.pad(~map_.sampled, 1)
        beside = unknown[2:, 1:-1] | unknown[:-2, 1:-1] | unknown[1:-1, 2:] | unknown[1:-1, :-2]
        ids = belief.feasible_poses(0)
        frontier = ids[beside.ravel()[ids // 16]]
        shows = belief.rating_function.count_unknown_cells(map_, frontier)
        assert frontier[shows > 0].size
        assert beside.flat[pose // 16]
        assert steps[pose // 16] == steps[frontier[shows > 0] // 16].min()
        here = frontier[frontier // 16 == pose // 16]
        assert (
            shows[frontier == pose] == belief.rating_function.count_unknown_cells(map_, here).max()
        )
        seen += steps[pose // 16] > 1
    assert seen > 3


def test_frontier_without_a_frontier_takes_the_nearest_cell_that_shows_the_unknown():
    env = env_with_world(open_world(), n_robots=1, settings=SETTINGS)
    known = np.zeros((40, 40), dtype=bool)
    known[10:31, 10:31] = True
    belief = set_poses(env, (20, 20, 0), known=known)
    edge = known.copy()
    edge[11:30, 11:30] = False
    set_cells(belief.map, np.flatnonzero(edge), 0.2)  # sampled, but not known to be free
    pose = chosen(FrontierPolicy("nearest"), belief)
    assert pose // 16 == 20 * 40 + 20
    shown = belief.rating_function.count_unknown_cells(belief.map, np.arange(16) + 820 * 16)
    assert shown[pose % 16] == shown.max() > 0


def test_frontier_stays_feasible_when_everything_is_known():
    env = env_with_world(open_world(), n_robots=1, settings=SETTINGS)
    belief = set_poses(env, (20, 20, 5), known=np.ones((40, 40), dtype=bool))
    assert chosen(FrontierPolicy("nearest"), belief) // 16 == belief.cell(0)


# raster


def test_raster_visits_the_poses_in_sequence_and_wraps_around():
    env = env_with_world(open_world(), n_robots=1, settings=SETTINGS)
    cells = [(19, 20), (20, 20), (20, 21)]
    known = [x * 40 + y for x, y in cells]
    everything = [pose_id(env, x, y, heading) for x, y in cells for heading in range(16)]
    policy = coopmap_baselines.make("raster")
    at, visited = (20, 20, 14), []
    for _ in range(2 * len(everything)):
        pose = chosen(policy, set_poses(env, at, known=known))
        visited.append(pose)
        at = (*divmod(pose // 16, 40), pose % 16)
    first = everything.index(pose_id(env, 20, 20, 15))
    turned = everything[first:] + everything[:first]
    assert visited == turned * 2


def test_raster_takes_the_next_candidate_in_sequence():
    env = PlanarEnv(1, "candidates", n_candidates=6, max_scans=10)
    observations, _ = env.reset(seed=0)
    policy = coopmap_baselines.make("raster")
    while env.agents:
        here, candidates = env.belief().pose_ids[0], env.belief().candidates[0]
        later = candidates[candidates > here]
        expected = later.min() if later.size else candidates.min()
        observations, *_ = env.step(policy.act(env.belief(), observations))
        assert env.belief().pose_ids == (expected,)


# random


@pytest.mark.parametrize("mode", ["pose", "candidates"])
def test_random_takes_every_pose_as_often(mode):
    env = env_with_world(
        open_world(), n_robots=1, settings=SETTINGS, action_mode=mode, n_candidates=40
    )
    belief = set_poses(env, (20, 20, 0), known=[20 * 40 + 21])
    policy = coopmap_baselines.make("random")
    policy.reset(np.random.default_rng(0))
    counts = np.bincount([chosen(policy, belief) for _ in range(3200)])
    counts = counts[counts > 0]
    assert len(counts) == 32
    np.testing.assert_allclose(counts, 100, atol=40)  # four standard errors


# information gain


def first_hit_entropy(p):
    """Entropy of the first occupied cell along a beam, over all 2^k maps of its k cells."""
    chances = dict.fromkeys(range(len(p) + 1), 0.0)
    for cells in itertools.product([False, True], repeat=len(p)):
        chance = math.prod(q if occupied else 1 - q for occupied, q in zip(cells, p, strict=True))
        chances[cells.index(True) if any(cells) else len(p)] += chance
    return -sum(c * math.log(c) for c in chances.values() if c > 0)


@pytest.mark.parametrize("quarter", range(4))
@pytest.mark.parametrize("prior", [0.5, 0.12])
def test_the_information_of_one_beam_is_the_entropy_of_its_measurement(quarter, prior):
    camera = PlanarCamera(field_of_view=0.01, depth_of_field=8.0, n_beams=1)
    settings = PlanarSettings(camera=camera, noise=NO_NOISE, n_headings=4)
    env = env_with_world(open_world(), n_robots=1, settings=settings)
    rng = np.random.default_rng(quarter)
    dx, dy = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter]
    for _ in range(5):
        belief = set_poses(env, (23, 20, 0))
        cells = [(20 + k * dx) * 40 + 20 + k * dy for k in range(9)]
        for cell in np.array(cells)[rng.random(9) < 0.7]:
            set_cells(belief.map, [cell], rng.uniform(0.01, 0.5))
        known = belief.map.sampled.flat[cells]
        p = np.where(known, belief.map.probability.flat[cells], prior)
        information = PlanarMutualInformation(
            belief.rating_function, prior=prior
        ).mutual_information(belief.map, [pose_id(env, 20, 20, quarter)])
        assert information[0] == pytest.approx(first_hit_entropy(p), abs=1e-9)


def test_entropy_that_no_scan_can_reduce_does_not_count():
    env = env_with_world(open_world(), n_robots=1, settings=SETTINGS)
    belief = set_poses(env, (20, 20, 0), known=list(range(40 * 40)))
    clamp = belief.map.log_odds_range.max_probability
    known = PlanarMutualInformation(
        belief.rating_function, known_probability=clamp
    ).mutual_information(belief.map, [8000])
    assert known[0] == pytest.approx(0.0, abs=1e-3)
    assert (
        PlanarMutualInformation(belief.rating_function).mutual_information(belief.map, [8000])[0]
        > 0.1
    )


@pytest.mark.parametrize("options", [{"prior": 0.0}, {"prior": 1.0}, {"known_probability": 0.5}])
def test_probabilities_of_beam_information_out_of_range_are_named(options):
    env = env_with_world(open_world(), n_robots=1, settings=SETTINGS)
    (name,) = options
    with pytest.raises(ValueError, match=name):
        PlanarMutualInformation(env.unwrapped._belief.rating_function, **options)


def test_the_score_of_information_gain_is_a_fraction_of_a_full_view_minus_motion():
    env = env_with_world(open_world(), n_robots=1, settings=SETTINGS)
    belief = set_poses(env, (20, 20, 0))
    policy = coopmap_baselines.make("information_gain", motion_weight=0.125, prior=0.2)
    ids = np.array([pose_id(env, 20, 20, 0), pose_id(env, 23, 20, 0)])
    information = PlanarMutualInformation(
        belief.rating_function, 0.2, belief.map.log_odds_range.max_probability
    )
    h = -0.2 * math.log(0.2) - 0.8 * math.log(0.8)
    shares = information.mutual_information(belief.map, ids) / (
        belief.rating_function.fan.max_visible_cells * h
    )
    expected = shares - 0.125 * np.array([0.0, 3.0])
    assert policy.score(belief, 0, ids, None) == pytest.approx(expected)


@pytest.mark.parametrize("prior", [0.0, 1.0, 1, "0.1"])
def test_a_wrong_prior_is_named_with_its_value(prior):
    with pytest.raises(ValueError, match=f"prior .* got {prior!r}"):
        coopmap_baselines.make("information_gain", prior=prior)


def test_information_gain_prefers_the_unknown_to_the_certain():
    env = env_with_world(open_world(), n_robots=1, settings=SETTINGS)
    policy = coopmap_baselines.make("information_gain", motion_weight=0.0)
    known = np.zeros((40, 40), dtype=bool)
    known[20:] = True  # all that lies towards +x
    scores = policy.score(
        set_poses(env, (20, 20, 0), known=known), 0, np.arange(16) + 820 * 16, None
    )
    assert scores[8] > scores[0]
    assert np.argmax(scores) not in (14, 15, 0, 1, 2)


# coverage


def test_coverage_counts_the_unknown_cells_in_view_minus_the_way():
    env = env_with_world(open_world(), n_robots=1, settings=SETTINGS)
    policy = coopmap_baselines.make("coverage", motion_weight=0.25)
    rng = np.random.default_rng(0)
    for _ in range(3):
        belief = write_random_map(env, rng)
        ids = rng.choice(belief.feasible_poses(0), 12)
        reserved_mask = (rng.random(1600) < 0.3).astype(np.uint8)
        taken = {divmod(int(cell), 40) for cell in np.flatnonzero(reserved_mask)}
        for mates, left_out in ((None, set()), (reserved_mask, taken)):
            for pose, score in zip(ids, policy.score(belief, 0, ids, mates), strict=True):
                seen = visible_cells(belief.map, SETTINGS.camera, belief.lattice, pose)
                count = sum(not belief.map.sampled[cell] for cell in seen - left_out)
                x, y, _ = belief.lattice.pose(int(pose))
                way = math.hypot(x - 20.5, y - 20.5)
                share = count / belief.rating_function.fan.max_visible_cells
                assert score == pytest.approx(share - 0.25 * way, abs=1e-12)


@pytest.mark.parametrize("name", ["coverage", "information_gain"])
def test_the_heavier_the_motion_the_nearer_the_pose(name, small_scene):
    env = PlanarEnv(1, scene=small_scene)
    env.reset(seed=3)
    ways = []
    for weight in (0.0, 0.01, 0.1, 10.0):
        belief = env.belief()
        policy = coopmap_baselines.make(name, search="exhaustive", motion_weight=weight)
        pose = chosen(policy, belief)
        ways.append(np.linalg.norm((belief.lattice.poses(pose) - belief.camera_poses[0])[:2]))
    assert ways == sorted(ways, reverse=True)
    assert ways[0] > ways[-1] == 0


def test_frontier_takes_the_nearest_frontier_among_candidates_in_any_order():
    env = env_with_world(
        open_world(), n_robots=1, settings=SETTINGS, action_mode="candidates", n_candidates=200
    )
    known = [x * 40 + y for x in range(14, 27) for y in range(17, 24)]
    belief = set_poses(env, (20, 20, 0), known=known)
    candidates = belief.candidates[0]
    shows = belief.rating_function.count_unknown_cells(belief.map, candidates) > 0
    at_frontier = adjacent_to_unknown(belief.map)[candidates // 16]
    steps = ReachableCells.search(belief.map, belief.cell(0)).steps
    pose = chosen(FrontierPolicy("nearest"), belief)
    assert at_frontier[candidates == pose].all()
    assert steps[pose // 16] == steps[candidates[shows & at_frontier] // 16].min()
