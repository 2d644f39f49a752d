import tomllib
from importlib import import_module
from pathlib import Path

import pytest

import coopmap_baselines
from coopmap_baselines import POLICIES, make
from coopmap_env.evaluation import Policy

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_a_policy_is_made_by_its_name():
    for name, policy in POLICIES.items():
        assert type(make(name)) is policy
        assert isinstance(make(name), Policy)
        assert f"\n{name} " in coopmap_baselines.__doc__


def test_options_reach_the_policy():
    policy = make("rating_function", search=7, coordination="sequential")
    assert policy.search == 7
    assert policy.coordination == "sequential"
    assert make("coverage", motion_weight=0.5).motion_weight == 0.5


def test_an_unknown_name_is_rejected_with_the_choices():
    with pytest.raises(ValueError, match=r"'greedy'; choose from rating_function, .*, random"):
        make("greedy")


@pytest.mark.parametrize("name", ["rating_function", "information_gain", "coverage"])
@pytest.mark.parametrize("search", [0, -1, 2.5, True, None, "all"])
def test_a_wrong_search_is_named_with_its_value(name, search):
    with pytest.raises(ValueError, match=f"search .* got {search!r}"):
        make(name, search=search)


@pytest.mark.parametrize("name", ["rating_function", "information_gain", "coverage", "frontier"])
@pytest.mark.parametrize("coordination", ["joint", None, True])
def test_a_wrong_coordination_is_named_with_its_value(name, coordination):
    with pytest.raises(ValueError, match=f"coordination .* got {coordination!r}"):
        make(name, coordination=coordination)


@pytest.mark.parametrize("name", ["information_gain", "coverage"])
@pytest.mark.parametrize("weight", [-0.1, float("nan"), float("inf"), "1", None])
def test_a_wrong_weight_is_named_with_its_value(name, weight):
    with pytest.raises(ValueError, match=f"motion_weight .* got {weight!r}"):
        make(name, motion_weight=weight)


def test_the_entry_points_of_the_project_are_the_policies():
    points = PROJECT["project"]["entry-points"]["coopmap.policies"]
    own = {name: at for name, at in points.items() if at.startswith("coopmap_baselines.")}
    assert list(own) == list(POLICIES)
    for name, at in own.items():
        module, _, attribute = at.partition(":")
        assert getattr(import_module(module), attribute) is POLICIES[name]


def test_every_folder_with_modules_is_a_package_that_setuptools_finds():
    for folder in PROJECT["tool"]["setuptools"]["package-dir"].values():
        for module in (ROOT / folder).rglob("*.py"):
            assert (module.parent / "__init__.py").exists()
