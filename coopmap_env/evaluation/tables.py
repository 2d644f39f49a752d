"""Intervals and tables as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from coopmap_env.evaluation.statistics import Interval


def format_interval(
    values: Interval | Mapping[str, float],
    scale: float = 1.0,
    digits: int = 2,
    bounds: bool = True,
    sign: str = "",
) -> str:
    """An interval as text, such as "9.12 [8.90, 9.33]".

    Parameters
    ----------
    values : Interval or mapping
        An interval, or its JSON values "estimate", "low" and "high".
    scale : float
        Factor to the unit of the text, such as 100 for percent.
    digits : int
        After the decimal point.
    bounds : bool
        Whether to write the bounds after the estimate.
    sign : str
        "+" writes the sign of positive numbers too.
    """
    numbers = values.as_dict() if isinstance(values, Interval) else values
    scaled = Interval(**{name: scale * number for name, number in numbers.items()})
    spec = f"{sign}.{digits}f"
    return format(scaled, spec) if bounds else format(scaled.estimate, spec)


def markdown_table(rows: Sequence[Sequence[str]], padded: bool = False) -> str:
    """A table in Markdown.

    Parameters
    ----------
    rows : sequence of sequences of str
        Cells; the first row is the header.
    padded : bool
        Whether all cells of a column are equally wide, for terminals.
    """
    if padded:
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        rows = [
            [cell.ljust(width) for cell, width in zip(row, widths, strict=True)] for row in rows
        ]
        rule = "|".join("-" * (width + 2) for width in widths)
    else:
        rule = "|".join(["---"] * len(rows[0]))
    lines = [f"| {' | '.join(row)} |" for row in rows]
    lines.insert(1, f"|{rule}|")
    return "\n".join(lines)
