"""The page of a family in Markdown."""

from __future__ import annotations

import math

from coopmap_env.evaluation.tables import format_interval, markdown_table
from coopmap_env.families import Family
from coopmap_env.studies.families.table import SCANS, Row, Table


def table_text(table: Table) -> str:
    """The table in Markdown."""
    titles = ["policy", "kind", *(column.title for column in table.columns)]
    titles += ["decision, ms", "beyond one step, points"]
    return markdown_table([titles, *(_cells(table, row) for row in table.rows)])


def _cells(table: Table, row: Row) -> list[str]:
    cells = [
        format_interval(
            row.scores[column.score], column.scale, column.digits, bounds=column is not SCANS
        )
        if column.score in row.scores
        else ""
        for column in table.columns
    ]
    cells.append("" if row.decision_ms is None else f"{row.decision_ms:.1f}")
    beyond = "" if row.beyond is None else format_interval(row.beyond, 100, 1, sign="+")
    return [row.name, row.kind, *cells, beyond]


def page_text(
    family: Family, table: Table, split: str, n_worlds: int, policies: str | None = None
) -> str:
    """The page of a family.

    Parameters
    ----------
    family : Family
    table : Table
    split : str
    n_worlds : int
        Worlds that were played, from seed 0 on.
    policies : str, optional
        Names in the table, separated by semicolons; by default all that fit the family.
    """
    budget = [f"{family.budget['n_robots']} robots", f"{family.budget['max_scans']} scans each"]
    if "max_time" in family.budget:
        budget.append(f"{family.budget['max_time']:g} s on the clock of the team")
    kind = "planar" if family.env_name == "planar" else "field"
    fields = ", ".join(f"{name} {value}" for name, value in family.scene.items() if name != "name")
    scene = f"`{family.scene['name']}`" + (f" ({fields})" if fields else "")
    command = (
        f"python -m coopmap_env.studies.families {family.name} --split {split} "
        f"--worlds {n_worlds} --out results/families"
    )
    about = f"{_explanation(family)}\n{_about_bound(family, table)}"
    if policies is not None:
        command += f' \\\n    --policies "{policies}"'
    return f"""# {family.name}

{family.summary}

| | |
|---|---|
| id | `{family.env_id}` |
| Python | `coopmap_env.families.make("{family.name}", split="test")` |
| commands | `--family {family.name}` of `coopmap evaluate`, `train` and `submit` |
| world | {kind}, scene {scene} |
| budget | {", ".join(budget)} |

Means over {n_worlds} worlds of the split "{split}" [95 % bootstrap intervals]. {about}\
"Decision" is the CPU time that a decision of one robot takes in world 0. The last column compares
with the best one-step planner, {table.best_one_step}, world by world, by
{table.compared.title.rstrip(", %")}.

{table_text(table)}

```
{command}
```
"""


def _about_bound(family: Family, table: Table) -> str:
    """What the bound says, how good it is, and what it costs."""
    if table.bound is None:
        return ""
    seconds = table.bound.cpu_seconds
    cost = "" if math.isnan(seconds) else f"; one takes {seconds:.1f} CPU seconds (median)"
    gap = (
        f"The bound is {format_interval(table.bound.gap, 100, 1)} % above the best choice of views "
        f"that its search knows, which no policy need reach{cost}.\n"
    )
    if family.env_name == "planar":
        return gap
    clock = (
        f" It is of {table.bound.n_scans} scans, as many as would fit into the time without "
        "motions, and says little: there is no bound that counts motions yet."
        if "max_time" in family.budget
        else ""
    )
    return (
        "\nThe [bound](../bounds.md#the-covered-surface) is of what "
        f"{table.bound.n_scans} noise-free scans of each robot cover from the true camera poses "
        "of that set: home, the grid of the joint space and drawn poses, those that are free in "
        "the true world. It is certified for these poses alone, in any order and however "
        "far they are apart: scans from other poses, and noise, which puts voxels "
        "beside the surface, may cover more."
        f"{clock} {gap}\n"
    )


def _explanation(family: Family) -> str:
    clairvoyant = (
        "Clairvoyant policies [know the world](../bounds.md#what-knowing-the-world-would-bring) "
        "and keep all constraints; they are references."
    )
    if family.env_name == "planar":
        return (
            "Efficiency is what is shown beyond the start, as a fraction of what the [upper bound]"
            "(../bounds.md) allows: at the end, and of the area under the curve. "
        ) + clairvoyant
    return (
        "Surface is the covered fraction of the visible surface, at the end and as the area under "
        "its curve; shown are the voxels that scans truly showed. "
        f"{clairvoyant} They choose among the poses of a finite set."
    )
