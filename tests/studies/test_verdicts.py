"""Sentences of the comparison follow from intervals."""

import pytest

from coopmap_env.evaluation.statistics import Interval
from coopmap_env.studies.benchmark.tables import equal_motion_table, verdict_table
from coopmap_env.studies.benchmark.verdicts import (
    equal_motion_sentence,
    headlines,
    interval_verdict,
    verdict_sentence,
)


def test_an_interval_that_touches_zero_is_no_verdict():
    assert interval_verdict(Interval(0.2, 0.1, 0.3)) == "higher"
    assert interval_verdict(Interval(-0.2, -0.3, -0.1)) == "lower"
    assert interval_verdict(Interval(0.2, 0.0, 0.3)) == "no difference found"


def a_verdict(low, estimate, high, **changes):
    difference = {"estimate": estimate, "low": low, "high": high}
    return {
        "env_name": "planar",
        "worlds": 100,
        "score": "coverage_auc",
        "learned": "learned, 32 candidates",
        "spec": "coverage:motion_weight=0+coordination=sequential",
        "same_actions": True,
        "is_strongest": True,
        "difference": difference,
        "runs": [0.001, 0.002],
        "verdict": interval_verdict(Interval(**difference)),
    } | changes


@pytest.mark.parametrize(
    ("interval", "words"),
    [
        (
            (0.001, 0.002, 0.003),
            "learned, 32 candidates is higher than `coverage:motion_weight=0+coordination="
            "sequential` with the same actions, +0.20 [+0.10, +0.30] points per world.",
        ),
        (
            (-0.003, -0.002, -0.001),
            "learned, 32 candidates is lower than `coverage:motion_weight=0+coordination="
            "sequential` with the same actions, -0.20 [-0.30, -0.10] points per world.",
        ),
        (
            (-0.0011, 0.0002, 0.0016),
            "no difference found between learned, 32 candidates and `coverage:motion_weight=0+"
            "coordination=sequential` with the same actions, +0.02 [-0.11, +0.16] points per "
            "world.",
        ),
    ],
)
def test_a_sentence_names_the_opponent_in_full_and_claims_what_the_interval_carries(
    interval, words
):
    sentence = verdict_sentence(a_verdict(*interval))
    assert sentence == f"Planar-v1, 100 worlds, area under the coverage curve: {words}"


def test_a_reward_is_in_nats_and_another_kind_of_actions_is_named():
    sentence = verdict_sentence(a_verdict(1, 2, 3, score="reward", same_actions=False))
    assert "reward: learned" in sentence
    assert "with any pose (m = 100), +2.00 [+1.00, +3.00] nats" in sentence


def test_equal_motion_is_said_only_where_the_planners_move_as_much():
    entry = a_verdict(1e-3, 2e-3, 3e-3, planners="coverage", motion=320.4, is_equal=True)
    assert "higher than coverage at equal motion (320), +0.20" in equal_motion_sentence(entry)
    entry["is_equal"] = False
    assert "coverage with less motion (320)" in equal_motion_sentence(entry)
    row = equal_motion_table({"equal_motion": [{**entry, "planners_score": 0.07}]})[1]
    assert row[3:5] == ["320.4 (less)", "7.00"]


def test_a_row_of_the_table_has_the_spec_and_each_training_run():
    row = verdict_table([a_verdict(0.001, 0.002, 0.003)])[1]
    assert row[1].startswith("coverage:motion_weight=0+coordination=sequential, the same actions")
    assert row[1].endswith("(strongest)")
    assert row[3:] == ["+0.20 [+0.10, +0.30]", "higher", "+0.10, +0.20"]


def test_headlines_are_of_the_first_learned_method_of_each_kind_of_actions():
    kinds = {"map": "pose", "poses": "pose", "scorer": "candidates", "scorer 2": "candidates"}
    methods = {
        label: {"family": "learned", "env_kwargs": {"action_mode": mode}}
        for label, mode in kinds.items()
    }
    methods["coverage"] = {"family": "coverage", "env_kwargs": {"action_mode": "pose"}}
    part = {"env_name": "planar", "methods": methods}
    stated = [a_verdict(1e-3, 2e-3, 3e-3, learned=label) for label in kinds]
    stated.append(a_verdict(1e-3, 2e-3, 3e-3, learned="map", is_strongest=False))
    lines = headlines({"main": [part], "verdicts": stated, "sweeps": []})
    assert [line.split(": ")[1].split(" is ")[0] for line in lines] == ["map", "scorer"]
