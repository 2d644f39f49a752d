"""Map networks of several training seeds: how much of a result is the seed's.

::

    python -m coopmap_env.studies.map_network_seeds --worlds 20 --out OUT --page PAGE

plays `predictive` and `predictive_surface` with the network of each training seed that ships, and
the strongest planners without predictions, on the same worlds. What was interrupted goes on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_agents.map_prediction.library import shipped_seeds
from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.evaluation import BOOTSTRAP_SEED, compare, with_efficiencies
from coopmap_env.evaluation.statistics.training_runs import mean, mean_difference
from coopmap_env.evaluation.tables import format_interval, markdown_table
from coopmap_env.families import get
from coopmap_env.studies.common.table_study import Worlds, run_table_study


class Task(NamedTuple):
    """Worlds, what counts there, and who plays."""

    env_name: str
    arguments: Mapping[str, Any]
    settings: Any = None

    @property
    def score(self) -> str:
        """Column of the scores that are compared, fractions."""
        return "efficiency" if self.env_name == "planar" else "surface_coverage_auc"

    @property
    def predictive(self) -> str:
        """The policy on predicted maps."""
        return "predictive" if self.env_name == "planar" else "predictive_surface"

    @property
    def opponents(self) -> tuple[str, ...]:
        """The strongest planners that predict nothing, with as many poses to choose from."""
        return OPPONENTS[self.env_name]

    @property
    def seeds(self) -> list[int]:
        """Training seeds of the networks that ship."""
        return shipped_seeds(2 if self.env_name == "planar" else 3)


OPPONENTS = {
    "planar": ("lookahead:horizon=1+search=1000", "lookahead:search=1000"),
    "field": ("surface", "rating_function:search=100+coordination=sequential"),
}
SCORE_TEXTS = {
    "efficiency": "efficiency at the end",
    "surface_coverage_auc": "area under the curve of the covered surface",
}


def _of_family(name: str) -> Task:
    family = get(name)
    return Task(family.env_name, family.env_kwargs, family.settings)


TASKS = {
    "the setting of the paper": Task("planar", {}),
    "crowded": _of_family("crowded"),
    "long": _of_family("long"),
    "the default scene of the field": Task("field", {}),
    "occluded": _of_family("occluded"),
}
"""By name."""


def play(task: Task, worlds: Worlds) -> dict[str, NDArray[np.float64]]:
    """Scores by policy, each of shape (n_runs, n_worlds); resumable.

    The first policy is that on predicted maps, with one run for each training seed.
    """
    arguments, seeds = {**task.arguments, "split": worlds.split}, range(worlds.n)
    runs = [f"{task.predictive}:seed={seed}" for seed in task.seeds]
    found = compare(
        [*runs, *task.opponents],
        seeds,
        arguments,
        worlds.folder / "episodes",
        task.settings,
        worlds.workers,
        env_name=task.env_name,
    )
    if task.env_name == "planar":
        found = with_efficiencies(
            found, seeds, arguments, worlds.folder / "bounds", task.settings, worlds.workers
        )
    scores = {spec: own.table[task.score] for spec, own in found.items()}
    return {
        task.predictive: np.array([scores[run] for run in runs]),
        **{spec: scores[spec][None] for spec in task.opponents},
    }


def table_text(played: Mapping[str, Mapping[str, NDArray[np.float64]]]) -> str:
    """The table in Markdown: means, those of each seed, and differences world by world."""
    rows = [["task", "score, %", "policy", "mean", "of each training seed", "beyond it, points"]]
    for name, scores in played.items():
        task = TASKS[name]
        ours = scores[task.predictive]
        for spec, own in scores.items():
            each = (
                ", ".join(f"{100 * run.mean():.1f}" for run in own)
                if spec == task.predictive
                else ""
            )
            beyond = (
                ""
                if spec == task.predictive
                else format_interval(mean_difference(ours, own), 100, 1, sign="+")
            )
            interval = mean(own, np.random.default_rng(BOOTSTRAP_SEED))
            rows.append(
                [
                    name,
                    SCORE_TEXTS[task.score],
                    f"`{spec}`",
                    format_interval(interval, 100, 1),
                    each,
                    beyond,
                ]
            )
    return markdown_table(rows)


def page_text(table: str, split: str, n_worlds: int) -> str:
    """The page of the table."""
    return f"""# Predicted maps of several trainings

Networks that predict maps were trained several times, each time with other worlds, weights and
orders of examples ([how](map_prediction.md)). All of them play on the first {n_worlds} worlds of
the split "{split}", beside the strongest planners without predictions. Means over trainings and
worlds with 95 % bootstrap intervals of both. The last column has how much the policy on predicted
maps is beyond a planner: the mean difference world by world, with its 95 % t interval over worlds
and trainings.

{table}

```
python -m coopmap_env.studies.map_network_seeds \\
    --split {split} --worlds {n_worlds} --out results/map_network_seeds
```
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Play all of them, print the table, write the page."""
    run_table_study(
        "coopmap_env.studies.map_network_seeds",
        "Map networks of several training seeds on the same worlds.",
        TASKS,
        lambda name, worlds: play(TASKS[name], worlds),
        table_text,
        page_text,
        arguments,
    )


if __name__ == "__main__":
    with errors_as_lines("map_network_seeds"):
        main()
