"""Kernels that do not count references are called by kernels alone; steps keep no arrays."""

import ast
import sys
from pathlib import Path

import numpy as np
import pytest

import coopmap_env
from coopmap_env import planar_v1
from coopmap_env.core.kernels import borrowing_kernel, kernel

PACKAGE = Path(coopmap_env.__file__).parent


def decorators(function):
    return {one.id for one in function.decorator_list if isinstance(one, ast.Name)}


def functions(tree):
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def test_only_kernels_call_kernels_that_do_not_count_references():
    trees = {path: ast.parse(path.read_text()) for path in PACKAGE.rglob("*.py")}
    borrowing = {
        function.name
        for tree in trees.values()
        for function in functions(tree)
        if "borrowing_kernel" in decorators(function)
    }
    assert len(borrowing) > 20
    found = []
    for path, tree in trees.items():
        imported = {
            alias.asname or alias.name
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        own = {function.name for function in functions(tree)}
        for function in functions(tree):
            if any("kernel" in name for name in decorators(function)):
                continue
            names = {
                node.func.id
                for node in ast.walk(function)
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
            }
            found += [(path.name, function.name, n) for n in names & borrowing & (imported | own)]
    assert found == []


def make_borrowing_kernel_and_caller():
    @borrowing_kernel
    def total(values):
        return values.sum()

    @kernel
    def twice(values):
        return 2.0 * total(values)

    return total, twice


@pytest.mark.parametrize("called_first", [0, 1])
def test_a_call_from_python_keeps_no_reference_to_its_arrays(called_first):
    kernels, values = make_borrowing_kernel_and_caller(), np.arange(4.0)
    kernels[called_first](values)
    total, twice = kernels
    before = sys.getrefcount(values)
    for _ in range(3):
        assert (total(values), twice(values)) == (6.0, 12.0)
    assert total(np.arange(4)) == 6  # another signature
    assert sys.getrefcount(values) == before


@pytest.mark.parametrize("mode", ["pose", "candidates"])
def test_a_step_keeps_no_reference_to_its_arrays(mode):
    env = planar_v1.parallel_env(action_mode=mode, max_scans=20)
    env.reset(seed=0)
    action = np.zeros(3, dtype=np.float32) if mode == "pose" else 0
    arrays = env._worlds.arrays
    counts = []
    for _ in range(4):
        observations, *_ = env.step(dict.fromkeys(env.agents, action))
        belief = env.belief()
        belief.rate(0, belief.random_poses(0, 5, np.random.default_rng(0)))
        belief.feasible_poses(0)
        belief.rate_team(belief.pose_ids)
        env.state()
        counts.append(
            [
                sys.getrefcount(observations["robot_0"]["map"].base),
                *map(
                    sys.getrefcount, (arrays.log_odds_fixed, arrays.pose_ids, belief.map.arrays[0])
                ),
            ]
        )
    assert counts[-1] == counts[1]
