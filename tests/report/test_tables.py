"""The table helper: text, the best of a column or of a row, and cells that are marked by themselves."""

import math

from torchbrdf.report.tables import Column, table


def best(made):
    return [[cell.best for cell in row] for row in made.rows]


def test_the_best_of_a_column():
    values = {"a": (3.0, 3.0), "b": (1.0, 4.0), "c": (math.nan, 2.0)}
    columns = [
        Column("name", str),
        Column("low", lambda row: values[row][0], ".1f", min),
        Column("high", lambda row: values[row][1], lambda x: f"<{x:g}>", max),
    ]
    made = table("T", "N", values, columns)
    assert (made.title, made.note, made.head) == ("T", "N", ["name", "low", "high"])
    assert [[cell.text for cell in row] for row in made.rows] == [
        ["a", "3.0", "<3>"],
        ["b", "1.0", "<4>"],
        ["c", "nan", "<2>"],
    ]
    assert best(made) == [[False, False, False], [False, True, True], [False, False, False]]


def test_the_best_of_some_columns_in_each_row():
    columns = [
        Column(f"{group}{k}", lambda row, k=k, sign=sign: row[k], "g", min, among=group, key=lambda x, s=sign: s * x)
        for group, sign in (("less", 1), ("more", -1))
        for k in (0, 1)
    ]
    made = table("", "", [(1, 2), (5, None), (4, 4)], columns)
    assert best(made) == [[True, False, False, True], [True, False, True, False], [True] * 4]
    assert made.rows[1][1].text == ""


def test_cells_that_are_marked_by_themselves():
    (row,) = table(
        "", "", [2], [Column("x", lambda row: row, bold=lambda row: row > 1, outlier=lambda row: row > 3)]
    ).rows
    assert row[0].best and not row[0].outlier
