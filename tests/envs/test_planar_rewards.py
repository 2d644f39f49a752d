import math
from dataclasses import replace

import numpy as np
import pytest
from plain.planar_worlds import NO_NOISE, env_with_world, open_world, pose_id, set_poses
from plain.rollouts import MODES, random_actions
from plain.views import new_information, visible_cells

import coopmap_baselines
from coopmap_env.envs import REWARD_TERMS
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.envs.rewards import RewardScale, StepOutcome, reward_terms
from coopmap_env.information import PlanarRatingSettings, ViewContext
from coopmap_env.mapping import ScanGain
from coopmap_env.sensing import PlanarCamera
from coopmap_env.simulation.scenes.planar import Obstacles, Rooms

SMALL = Obstacles(shape=(48, 48))


def plain_rating(env, map_, robot, before, after, reserved_mask):
    """Eqs. 5 to 9 of one pose in plain Python: (NI, d, RF)."""
    belief, s = env.belief(), env.settings.rating
    rated = (map_, env.settings.camera, belief.lattice, after)
    ni = new_information(*rated, s, belief.rating_function.fan.max_visible_cells, reserved_mask)
    (x, y, heading), (x0, y0, heading0) = map(belief.lattice.pose, (after, before))
    turn = abs(math.remainder(heading - heading0, math.tau))
    d = math.sqrt(s.alpha_position * ((x - x0) ** 2 + (y - y0) ** 2) + s.alpha_heading * turn**2)
    p = map_.probability.flat[after // belief.lattice.n_headings]
    return ni, d, (ni - s.K * d**s.exponent) * (1 - p)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    "rating",
    [
        PlanarRatingSettings(),
        PlanarRatingSettings(K=0.05, exponent=1.5, alpha_heading=0.7, n_gray_bins=20),
    ],
)
@pytest.mark.parametrize("interpretation", ["literal", "distance_free"])
def test_rating_is_eq_9_of_the_executed_pose_on_the_map_before_the_scan(
    mode, rating, interpretation
):
    settings = PlanarSettings(rating=replace(rating, interpretation=interpretation))
    env = PlanarEnv(3, mode, scene=SMALL, max_scans=4, settings=settings)
    camera, lattice = settings.camera, None
    env.reset(seed=1)
    rng = np.random.default_rng(1)
    while env.agents:
        lattice = env.belief().lattice
        map_, before = env.belief().map.copy(), env.belief().pose_ids
        _, rewards, _, _, infos = env.step(random_actions(env, rng))
        reserved_mask = set()
        for robot, (agent, info) in enumerate(infos.items()):
            executed = env.belief().pose_ids[robot]
            ni, d, rf = plain_rating(env, map_, robot, before[robot], executed, reserved_mask)
            # the histogram's terms come from a table: sums differ by rounding
            assert info["new_information"] == pytest.approx(ni, abs=1e-12)
            assert info["distance"] == pytest.approx(d, abs=1e-12)
            assert info["reward_rating"] == pytest.approx(rf, abs=1e-12)
            assert rewards[agent] == info["reward_rating"]
            reserved_mask |= visible_cells(map_, camera, lattice, executed)


@pytest.mark.parametrize("scene", [SMALL, Rooms(shape=(48, 48))])
def test_the_sequential_exhaustive_planner_maximises_the_reward(scene):
    env = PlanarEnv(2, scene=scene, max_scans=6)
    policy = coopmap_baselines.make(
        "rating_function", search="exhaustive", coordination="sequential"
    )
    compared = 0
    for seed in range(2):
        observations, _ = env.reset(seed=seed)
        policy.reset(np.random.default_rng(0))
        while env.agents:
            belief = env.belief()
            best, reserved_mask = [], np.zeros(belief.map.grid.n_cells, dtype=np.uint8)
            actions = policy.act(belief, observations)
            for robot, agent in enumerate(belief.agents):
                current = belief.pose_ids[robot]
                ids = belief.feasible_poses(robot)
                best.append(
                    belief.rating_function.rate(
                        belief.map,
                        ids,
                        belief.rating_function.distance(ids, current),
                        ViewContext(reserved_mask),
                    ).rating.max()
                )
                chosen, reason = belief.actions.decode(agent, actions[agent], belief)
                assert reason == 0
                reserved_mask[belief.rating_function.visible_cells(belief.map, chosen)] = 1
            observations, rewards, *_, infos = env.step(actions)
            if not any(info["collided"] for info in infos.values()):  # else one is paid as it stays
                assert list(rewards.values()) == best
                compared += 1
    assert compared > 6


@pytest.mark.parametrize("mode", MODES)
def test_information_telescopes_to_the_drop_of_entropy(mode, scene):
    env = PlanarEnv(3, mode, scene=scene, reward="information", max_scans=8)
    env.reset(seed=2)
    rng = np.random.default_rng(0)
    rating = env.belief().rating_function
    full_view, most = (
        rating.fan.max_visible_cells * math.log(2),
        math.log(rating.settings.n_gray_bins),
    )
    drop = paid = cost = marked = 0.0
    start = env.belief().map.entropy
    while env.agents:
        before = env.belief().map.entropy
        _, rewards, _, _, infos = env.step(random_actions(env, rng))
        if any(info["collided"] for info in infos.values()):  # a collision marks its cell too
            step = sum(info["entropy_reduction"] for info in infos.values())
            marked += before - env.belief().map.entropy - step
        for info in infos.values():
            drop += info["entropy_reduction"]
            cost += rating.settings.K * info["distance"] ** rating.settings.exponent / most
        paid += sum(rewards.values())
    # sums of some ten thousand cells' entropies, in different orders
    assert abs(marked) < 8 * math.log(2)
    assert drop + marked == pytest.approx(start - env.belief().map.entropy, rel=1e-9)
    assert drop > 0
    assert paid == pytest.approx(drop / full_view - cost, rel=1e-9)


@pytest.mark.parametrize("mode", MODES)
def test_coverage_sums_to_the_change_of_the_observed_fraction(mode, scene):
    env = PlanarEnv(3, mode, scene=scene, reward="coverage", max_scans=8)
    _, infos = env.reset(seed=2)
    start, rng, paid, cells = (
        infos["robot_0"]["observed_fraction"],
        np.random.default_rng(0),
        0.0,
        0,
    )
    while env.agents:
        _, rewards, _, _, infos = env.step(random_actions(env, rng))
        paid += sum(rewards.values())
        cells += sum(info["new_cells"] for info in infos.values())
        for info in infos.values():
            assert info["observed_fraction"] == env.belief().map.observed_fraction
    gained = env.belief().map.observed_fraction - start
    assert paid == pytest.approx(gained, rel=1e-12)
    assert cells == round(gained * env.belief().map.grid.n_cells) > 0


def test_two_robots_at_one_pose_are_paid_once():
    env = env_with_world(open_world(), n_robots=2, settings=PlanarSettings(noise=NO_NOISE))
    set_poses(env, (20, 20, 0), (20, 20, 0))
    max_visible_cells = len(
        env.belief().rating_function.visible_cells(env.belief().map, pose_id(env, 20, 20))
    )
    alone = env.belief().rating_function.rate(env.belief().map, [pose_id(env, 20, 20)], [0.0])
    _, _, _, _, infos = env.step({agent: np.zeros(3) for agent in env.agents})
    first, second = infos.values()
    assert first["new_information"] == alone.new_information[0] > 1
    assert first["new_cells"] == max_visible_cells - 1  # its own cell was known
    assert second["new_information"] == 0
    assert second["new_cells"] == 0
    assert second["reward_rating"] == second["reward_coverage"] == 0
    full_view = env.belief().rating_function.fan.max_visible_cells * math.log(2)
    assert second["reward_information"] == second["entropy_reduction"] / full_view


def test_back_to_back_robots_are_paid_as_if_alone():
    env = env_with_world(open_world(), n_robots=2, settings=PlanarSettings(noise=NO_NOISE))
    belief = set_poses(env, (30, 20, 0), (10, 20, 8))
    alone = belief.rating_function.new_information(belief.map, belief.pose_ids)
    *_, infos = env.step({agent: np.zeros(3) for agent in env.agents})
    np.testing.assert_array_equal([i["new_information"] for i in infos.values()], alone)


def test_all_terms_at_once_are_the_single_ones():
    rng = np.random.default_rng(5)
    scale = RewardScale(full_view_entropy=300.0, max_information=2.5, n_cells=40_000)
    for _ in range(20):
        gain = ScanGain(int(rng.integers(400)), float(rng.normal(50.0, 30.0)))
        rated, shown = rng.uniform(0.0, 3.0, 4).tolist(), int(rng.integers(400))
        outcome = StepOutcome(*rated, gain, float(rng.uniform()), shown)
        single = {name: term(outcome, scale) for name, term in REWARD_TERMS.items()}
        assert single["shown"] == shown / 40_000 - outcome.collision_cost
        assert reward_terms(outcome, scale, keeps_shown=True) == single
        del single["shown"]
        assert reward_terms(outcome, scale) == single


@pytest.mark.parametrize("reward", REWARD_TERMS)
def test_infos_contain_all_terms_and_the_shared_reward_is_the_mean(reward):
    own = PlanarEnv(3, scene=SMALL, reward=reward, max_scans=5)
    shared = PlanarEnv(3, scene=SMALL, reward=reward, team_reward="shared", max_scans=5)
    own.reset(seed=3)
    shared.reset(seed=3)
    rng = np.random.default_rng(0)
    while own.agents:
        actions = random_actions(own, rng)
        _, rewards, _, _, infos = own.step(actions)
        _, means, _, _, same = shared.step(actions)
        for agent, info in infos.items():
            known = {"rating", "information", "coverage"}
            assert set(REWARD_TERMS) == known | {"shown"}
            names = {key.removeprefix("reward_") for key in info if key.startswith("reward_")}
            assert names == known | ({"shown"} & {reward})
            assert type(rewards[agent]) is float
            assert rewards[agent] == info[f"reward_{reward}"]
            assert means[agent] == pytest.approx(sum(rewards.values()) / 3, rel=1e-12, abs=1e-15)
            assert same[agent] == info
        assert len(set(means.values())) == 1


def test_infos_hold_what_the_page_names():
    for mode in MODES:
        env = PlanarEnv(2, mode, scene=SMALL)
        keys = {
            "reward_rating", "reward_information", "reward_coverage", "rejected_reason", "collided",
            "new_information", "distance", "new_cells", "entropy_reduction", "n_scans",
            "elapsed_time", "observed_fraction",
        }  # fmt: skip
        _, infos = env.reset(seed=0)
        assert all(set(info) == keys for info in infos.values())
        *_, infos = env.step(random_actions(env, np.random.default_rng(0)))
        assert all(set(info) == keys for info in infos.values())


@pytest.mark.parametrize("camera", [PlanarCamera(), PlanarCamera(n_beams=70)])
def test_the_fused_map_depends_neither_on_the_order_of_the_actions_nor_on_who_stands_where(camera):
    settings = PlanarSettings(camera=camera, noise=NO_NOISE)
    world = open_world(walls=[(24, y) for y in range(14, 27)])
    poses = [(20, 20, 0), (21, 24, 15), (29, 20, 8)]
    maps = []
    for order in ([0, 1, 2], [2, 0, 1], [1, 0, 2]):
        for turned in (False, True):
            env = env_with_world(world, n_robots=3, settings=settings)
            set_poses(env, *(poses[robot] for robot in order))
            for _ in range(2):
                actions = {agent: np.zeros(3) for agent in env.agents}
                env.step(dict(reversed(actions.items())) if turned else actions)
            maps.append(env.belief().map)
    for map_ in maps:
        np.testing.assert_array_equal(map_.log_odds_fixed, maps[0].log_odds_fixed)
        np.testing.assert_array_equal(map_.sampled_mask, maps[0].sampled_mask)


def test_the_order_of_the_dict_of_actions_changes_nothing_with_noise_either():
    first, second = PlanarEnv(3, max_scans=4), PlanarEnv(3, max_scans=4)
    first.reset(seed=0)
    second.reset(seed=0)
    rng = np.random.default_rng(0)
    while first.agents:
        actions = random_actions(first, rng)
        _, rewards, *_ = first.step(actions)
        _, same, *_ = second.step(dict(reversed(actions.items())))
        assert rewards == same
        np.testing.assert_array_equal(first.state(), second.state())
