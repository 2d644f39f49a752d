"""Tables as text."""

from coopmap_env.evaluation.tables import markdown_table

ROWS = [["policy", "%"], ["raster", "3.5"]]


def test_a_table_in_markdown():
    assert markdown_table(ROWS) == "| policy | % |\n|---|---|\n| raster | 3.5 |"


def test_columns_of_a_padded_table_are_equally_wide():
    assert markdown_table(ROWS, padded=True).splitlines() == [
        "| policy | %   |",
        "|--------|-----|",
        "| raster | 3.5 |",
    ]
