"""Columns of the table of a metric: their records, and that every writer reads them."""

import math
from typing import get_args

import pandas as pd
import pytest
from data_frames import arrays, summary_frame

from rmpc_bench.analysis.comparison import comparisons
from rmpc_bench.analysis.result_rows import result_table
from rmpc_bench.analysis.shown_numbers import short
from rmpc_bench.analysis.statistics import SUMMARY, summary
from rmpc_bench.report.columns import COLUMNS, TableColumn
from rmpc_bench.report.notes import latex_tables
from rmpc_bench.report.page.rows import rows_of
from rmpc_bench.report.point_tables import summary_table
from rmpc_bench.report.screen_tables import row_lines
from rmpc_bench.report.summary import summarise, summary_markdown
from rmpc_bench.types.result_layout import Column


@pytest.fixture
def trials(make_trials):
    return make_trials({"mse": {"A": [1.0, 2.0, 4.0, 9.0], "B": [0.7, 1.5, 2.6, "diverged"]}})


@pytest.fixture
def table(trials):
    return result_table(trials, summary(trials), comparisons(trials), trials.metrics[0])


def test_the_keys_of_a_configuration_are_the_columns_with_a_head_in_latex():
    """The schema reads the keys from types, which does not import reports.  Others are refused before a run."""
    in_latex = {key for key, column in COLUMNS.items() if column.latex}
    assert in_latex == {*get_args(Column)} and len(in_latex) == len(get_args(Column))
    assert [key for key in in_latex if not COLUMNS[key].definition.endswith(".")] == []
    assert [key for key, column in COLUMNS.items() if not (column.head or column.latex)] == []


def test_a_row_has_every_number_of_the_summary(trials, table):
    for row, expected in zip(table.rows, summary(trials), strict=True):
        assert {name: row.described[name] for name in SUMMARY} == expected
    # The methods that are not computed have the same names, so that no cell fails for want of one.
    unknown = result_table(trials, summary(trials)[:1], comparisons(trials), trials.metrics[0]).rows[1].described
    assert {*SUMMARY} - {"method", "metric"} <= {*unknown} and math.isnan(unknown["se"]) and unknown["n"] == 0


def test_every_number_of_the_summary_is_rounded(trials):
    """A column with a number that is not would differ from machine to machine."""
    values = summary_frame(trials)
    numbers = values.select_dtypes("float").columns
    found = pd.DataFrame(summary_table(arrays(values.assign(**{name: 1 / 3 + 1e-15 for name in numbers}))))
    assert (found[numbers] == found["mean"].iloc[0]).all(axis=None) and found["mean"].iloc[0] != 1 / 3 + 1e-15


def test_a_new_record_is_all_that_a_new_column_needs(monkeypatch, trials, table):
    """The standard error of 1, 2, 4 and 9 is 1.780 by hand, that of 0.7, 1.5 and 2.6 is 0.551."""
    record = TableColumn(
        lambda _, rows: [short(row.described["se"]) for row in rows],
        head="error of the mean",
        latex="SE\n[u]",
        definition="SE: standard error of the mean of {metric}.",
        on_screen=True,
    )
    monkeypatch.setitem(COLUMNS, "se", record)
    page = rows_of(table)
    place = [head.text for head in page.heads].index("error of the mean")
    assert [row.cells[place].text for row in page.rows] == ["1.78", "0.551"]
    markdown = summary_markdown(trials, summary(trials), comparisons(trials))
    assert "| error of the mean |" in markdown and "| 0.551 |" in markdown
    latex = latex_tables(summarise(trials), columns=["mean", "se"])["mse"]
    assert r"SE\\{}[u]" in latex.body and "$0.551$" in latex.body
    assert "SE: standard error of the mean of MSE." in latex.note
    lines = row_lines(table, 120)
    end = lines[0].index("error of the mean") + len("error of the mean")
    assert [line[:end].split()[-1] for line in lines[1:]] == ["1.78", "0.551"]
    # It is the first to go where there is no room.
    narrow = row_lines(table, max(map(len, lines)) - 1)
    assert "error" not in narrow[0] and "mean MSE" in narrow[0]
