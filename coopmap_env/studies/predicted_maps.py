"""Planning on predicted maps beside planning without, also where the network was not trained.

::

    python -m coopmap_env.studies.predicted_maps --worlds 20 --out OUT --page docs/predicted_maps.md

plays `predictive` and planners with as many poses to choose from, in the setting of the paper and
in conditions that the network has not seen: other teams, sizes, scenes and noise. The page has the
differences world by world. What was interrupted goes on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.evaluation import BOOTSTRAP_SEED, Evaluation, compare, with_efficiencies
from coopmap_env.evaluation.statistics import bootstrap_mean, bootstrap_paired_difference
from coopmap_env.evaluation.tables import format_interval, markdown_table
from coopmap_env.families import get
from coopmap_env.studies.common.table_study import Worlds, run_table_study

PREDICTIVE = {
    "predicted map": "predictive",
    "predicted map, look-ahead": "predictive:horizon=2",
}
OPPONENTS = {
    "expected coverage": "lookahead:horizon=1+search=1000",
    "look-ahead": "lookahead:search=1000",
    "coverage, sequential": "coverage:search=1000+coordination=sequential",
    "rating function, sequential": "rating_function:search=1000+coordination=sequential",
}
"""All choose the first view among 1,000 random poses, and coordinate."""
SCORES = {
    "efficiency": "efficiency, %",
    "efficiency_auc": "efficiency of the area, %",
    "motion_distance": "motion",
}


class Condition(NamedTuple):
    """A task: arguments of the planar environment, and its settings."""

    arguments: Mapping[str, Any]
    settings: Any = None
    is_of_training: bool = False
    """Whether the network that ships with coopmap was trained on such worlds."""


def _of_family(name: str, noise: float = 1.0, **changes: Any) -> Condition:
    family = get(name)
    settings: PlanarSettings = family.settings
    louder = replace(settings.noise, intrinsic=noise * settings.noise.intrinsic)
    return Condition({**family.env_kwargs, **changes}, replace(settings, noise=louder))


CONDITIONS = {
    "the setting of the paper": Condition({}, is_of_training=True),
    "80 x 80 cells, 32 scans": Condition(
        {
            "scene": {"name": "obstacles", "shape": [80, 80], "occupied_fraction": 0.2},
            "max_scans": 32,
        }
    ),
    "house, 64 scans": Condition({"scene": "house", "max_scans": 64}),
    "crowded, 1 robot": _of_family("crowded", n_robots=1, max_scans=58),
    "crowded, 3 robots": _of_family("crowded", n_robots=3, max_scans=19),
    "crowded, 5 robots": _of_family("crowded", n_robots=5, max_scans=12),
    "crowded, 3 times the noise": _of_family("crowded", noise=3.0),
}
"""By name."""


def play_condition(condition: Condition, worlds: Worlds) -> dict[str, Evaluation]:
    """All policies on the first worlds of a split, with efficiencies; resumable."""
    arguments = {**condition.arguments, "split": worlds.split}
    seeds, specs = range(worlds.n), {**PREDICTIVE, **OPPONENTS}
    found = compare(
        list(specs.values()),
        seeds,
        arguments,
        worlds.folder / "episodes",
        condition.settings,
        worlds.workers,
    )
    scored = with_efficiencies(
        found, seeds, arguments, worlds.folder / "bounds", condition.settings, worlds.workers
    )
    return {name: scored[spec] for name, spec in specs.items()}


def table_text(played: Mapping[str, Mapping[str, Evaluation]]) -> str:
    """The table in Markdown: means with intervals, and differences world by world.

    The last column compares with the strongest opponent by the efficiency at the end.
    """
    rows = [["condition", "policy", *SCORES.values(), "against the strongest planner, points"]]
    for condition, evaluations in played.items():
        seen = "" if CONDITIONS[condition].is_of_training else " (not trained on)"
        ends = {name: own.table["efficiency"] for name, own in evaluations.items()}
        strongest = max(OPPONENTS, key=lambda name: float(ends[name].mean()))
        for name, own in evaluations.items():
            rng = np.random.default_rng(BOOTSTRAP_SEED)
            cells = [
                format_interval(bootstrap_mean(own.table[score], rng), scale, 1)
                for score, scale in zip(SCORES, (100, 100, 1), strict=True)
            ]
            versus = ""
            if name in PREDICTIVE:
                difference = bootstrap_paired_difference(ends[name], ends[strongest], rng)
                versus = f"{format_interval(difference, 100, 1, sign='+')} ({strongest})"
            rows.append([condition + seen, name, *cells, versus])
    return markdown_table(rows)


def page_text(table: str, split: str, n_worlds: int) -> str:
    """The page of the table."""
    return f"""# Planning on predicted maps

`predictive` is the planner `lookahead` on a map whose unknown part a network predicts
([how](map_prediction.md)). Here it plays beside planners without predictions. All choose each
robot's next view among 1,000 random poses, one robot after another. Means over {n_worlds} worlds of
the split "{split}" [95 % bootstrap intervals]. The last column has differences of the efficiency at
the end from the strongest of these planners on the same worlds. The network was trained on worlds
of the families and of the setting of the paper; the other conditions are new to it.

{table}

```
python -m coopmap_env.studies.predicted_maps \\
    --split {split} --worlds {n_worlds} --out results/predicted_maps
```
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Play all of them, print the table, write the page."""
    run_table_study(
        "coopmap_env.studies.predicted_maps",
        "Planning on predicted maps beside planning without.",
        CONDITIONS,
        lambda name, worlds: play_condition(CONDITIONS[name], worlds),
        table_text,
        page_text,
        arguments,
    )


if __name__ == "__main__":
    with errors_as_lines("predicted_maps"):
        main()
