"""Options of the planners, of every kind: accepted, or refused by their name."""

import inspect

import numpy as np
import pytest
from plain.odd_values import odd_values

from coopmap_baselines import POLICIES, make
from coopmap_env.envs import InvalidActionError
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.evaluation import rollout
from coopmap_env.simulation.scenes.planar import Obstacles

OPTIONS = [
    (name, option) for name in POLICIES for option in inspect.signature(POLICIES[name]).parameters
]


@pytest.mark.parametrize(("name", "option"), OPTIONS)
def test_an_option_of_any_kind_is_accepted_or_refused_by_its_name(name, option):
    for value in odd_values():
        try:
            policy = make(name, **{option: value})
        except ValueError as error:
            message = str(error)
        else:
            assert type(getattr(policy, option)) in (int, float, str, type(None))
            continue
        assert message.startswith(f"{option} must be")
        assert len(message) < 500


def test_numpy_scalars_are_options():
    policy = make(
        "information_gain",
        search=np.int64(5),
        motion_weight=np.float32(0.5),
        prior=np.float64(0.25),
    )
    assert (policy.search, policy.motion_weight, policy.prior) == (5, 0.5, 0.25)


def test_what_is_no_name_of_a_policy_is_refused():
    for name in odd_values():
        with pytest.raises(ValueError, match=r"unknown policy .*; choose from rating_function"):
            make(name)


def test_options_that_a_policy_does_not_have_are_refused_by_its_name():
    for options in ({"seed": 1}, {"search": 3, "prior": 0.5}):
        with pytest.raises(ValueError, match="rating_function has no argument"):
            make("rating_function", **options)


@pytest.mark.parametrize(
    "actions", [None, [], {}, {"robot_0": None, "robot_1": None}, {"robot_0": 0}]
)
def test_a_policy_that_gives_no_actions_is_named_by_them(actions):
    class Wrong:
        def reset(self, rng):
            pass

        def act(self, belief, observations):
            return actions

    env = PlanarEnv(
        scene=Obstacles(shape=(24, 24), side_max=8.0), settings=PlanarSettings(crop_cells=8)
    )
    with pytest.raises(InvalidActionError, match="robot_0"):
        list(rollout(env, Wrong(), seed=0))
