"""Learning curves of the pretrained policies, drawn from their records.

::

    python -m coopmap_env.studies.benchmark.learning_curves docs/learning_curves.png
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_agents.pretrained import pretrained_names, pretrained_record
from coopmap_env.evaluation.figures import import_pyplot, label_curves, save_figure


def draw_learning_curves(path: Path, score: str = "coverage_auc") -> None:
    """Draw the validation score of each policy against training steps, one line for each seed.

    Parameters
    ----------
    path : Path
        Of the PNG.
    score : str
        A validation score of the training records, a fraction; it is drawn in percent.
    """
    plt = import_pyplot()
    names = pretrained_names()
    figure, axes = plt.subplots(1, len(names), figsize=(3.6 * len(names), 3.0), squeeze=False)
    for axis, name in zip(axes[0], names, strict=True):
        _draw(axis, name, pretrained_record(name)["trainings"], score)
    axes[0][0].set_ylabel("area under the coverage curve, %\n(validation worlds)")
    figure.tight_layout()
    save_figure(figure, path)


def _draw(axis: Any, name: str, trainings: dict[str, Any], score: str) -> None:
    for seed, training in trainings.items():
        rows = training["rows"]
        steps = np.array([row["steps"] for row in rows]) / 1e3
        values = 100 * np.array([row["validation"][score] for row in rows])
        (line,) = axis.plot(steps, values, linewidth=1.2, label=f"seed {seed}")
        best = training["best_row"]
        axis.plot(steps[best], values[best], "o", color=line.get_color(), markersize=5)
    axis.set_title(name, fontsize=10)
    axis.set_xlabel("thousand steps")
    axis.grid(alpha=0.3)
    label_curves(axis)


if __name__ == "__main__":
    draw_learning_curves(Path(sys.argv[1]))
