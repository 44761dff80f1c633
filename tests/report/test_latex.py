"""Tables in LaTeX: rows, columns and numbers of the Markdown table, comments at the head, captions that define them."""

import re
from dataclasses import replace

import numpy as np
import pytest

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.latex import ALL_METRICS, name_lines, stacked
from rmpc_bench.report.latex_text import width_of
from rmpc_bench.report.notes import latex_tables
from rmpc_bench.report.summary import summarise
from rmpc_bench.types import DesignError, MetricInfo
from rmpc_bench.types.metric import Limit, Requirement


def rows_in(text: str) -> list[list[str]]:
    body = text[text.index(r"\midrule") + 9 : text.index(r"\bottomrule")]
    return [[cell.strip() for cell in line.removesuffix(r"\\").split(" & ")] for line in body.strip().split("\n")]


def table(make_trials, factor: float = 1.0) -> Trials:
    """Trials of three methods with two metrics, 30 runs each; the third method fails once."""
    rng = np.random.default_rng(3)
    base = factor * rng.lognormal(size=30)
    mse = {"S_1": base, "R": 0.8 * base * rng.lognormal(0, 0.05, 30), "Q": list(1.01 * base)}
    cost = {name: [each if isinstance(each, str) else 3e6 + 1e3 * float(each) for each in mse[name]] for name in mse}
    mse["Q"][4] = cost["Q"][4] = "diverged"
    infos = (MetricInfo("mse", "rad^2", "lower"), MetricInfo("input_cost", "V", "lower"))
    return make_trials({"mse": mse, "input_cost": cost}, infos, labels={"R": "R, $c=10^{-1}$"})


@pytest.fixture(scope="module")
def trials(make_trials):
    return table(make_trials)


@pytest.fixture(scope="module")
def summary(trials):
    return summarise(trials)


def test_numbers_are_those_of_the_markdown_table(trials, summary):
    text = latex_tables(summary, columns=["mean", "change", "counts"])["mse"].body
    markdown = summary.to_markdown()
    for row, method in zip(rows_in(text), trials.methods, strict=True):
        line = next(line for line in markdown.split("\n") if line.startswith(f"| {method} |")).replace("\u2212", "-")
        for cell in row[1:]:
            assert cell == "--" or "".join(re.findall(r"[-+.\d]", cell)) in "".join(re.findall(r"[-+.\d|]", line))


def test_every_table_has_a_head_a_caption_and_a_note(summary):
    """Comments come first, a hostile one too; the note has the baseline, failures and every column shown."""
    tables = latex_tables(summary)
    # Classes of documents set captions in capitals: one line without units.
    assert tables["mse"].caption == "MSE of 3 methods in 30 runs per method%\n"
    assert tables["input_cost"].caption.startswith("Input cost of") and ALL_METRICS in tables
    shown = ["mean", "median", "change", "counts", "superiority", "p", "verdict", "n"]
    note = latex_tables(summary, columns=shown)["mse"].note
    words = ("Mean:", "Median:", "paired", "Won/lost/tied:", "Superiority:", "Wilcoxon", "Failed runs: Q 1", r"S\_1")
    assert [word for word in words if word not in note] == []
    text = next(iter(latex_tables(summary, ["version 1", "run\n\\input{x}"]).values())).body.split("\n")
    assert text[0] == "% version 1" and text[1] == r"% run \input{x}" and text[2].startswith("% needs")
    assert text[3].startswith(r"\begin{tabular}{@{}l") and text[4] == r"\toprule"


def test_a_sweep_has_groups_of_rows_or_a_row_per_point(make_trials, make_sweep):
    """A single column is laid out with the methods as columns."""
    summary = summarise(make_sweep(*[({"plant.a": str(n)}, table(make_trials, n)) for n in (1.0, 2.0, 3.0)]))
    groups = latex_tables(summary, columns=["mean", "n"])["mse"].body
    assert groups.count(r"\multicolumn") == 3 and groups.count(r"\addlinespace") == 2
    rows = rows_in(latex_tables(summary, columns=["mean"])["mse"].body)
    assert [len(row) for row in rows] == [4, 4, 4]


def test_the_usual_columns_depend_on_the_width(summary):
    widths = [len(rows_in(latex_tables(summary, width=width)["mse"].body)[0]) for width in (120.0, 252.0, 1000.0)]
    assert widths == sorted(widths) and 3 <= widths[0] < widths[-1]


def test_long_names_and_estimated_widths():
    """Words of a metric break at blanks; widths are those of Computer Modern at 8 pt to a quarter (by TeX)."""
    assert name_lines(MetricInfo("steady_state_error", "", "zero")) == ["Steady", "state error"]
    assert name_lines(MetricInfo("estimation_mse", "", "lower")) == ["Estimation", "MSE"]
    assert name_lines(MetricInfo("x_0", "", "lower")) == ["$x_0$"]
    assert stacked(["a", "", "b"]).count(r"\\") == 1 and stacked(["a", ""]) == "a"
    for cell, points in (("$-11.9\\ [-13.2, -10.6]$", 85.0), ("$0.1064(7)$", 37.5), ("Won/lost/", 33.0)):
        assert 0.85 * points <= width_of(cell) <= 1.25 * points, (cell, width_of(cell))


def test_python_gives_the_tables_of_the_files(summary):
    """The primary metric by default; a wrong name and a wrong width say what is possible."""
    tables = latex_tables(summary)
    for name in ("input_cost", ALL_METRICS):
        assert summary.to_latex(name) == tables[name].body
    assert summary.to_latex() == tables["mse"].body
    assert "Won/lost/" in summary.to_latex("mse", columns=["counts"]) and "Mean" not in summary.to_latex(columns=["n"])
    assert len(summary.to_latex(width=700.0)) > len(summary.to_latex(width=150.0))
    with pytest.raises(DesignError, match="'msee' is not a known metric; did you mean 'mse'"):
        summary.to_latex("msee")
    tables = latex_tables(summary.shown(["Q", "R"], ["input_cost"]))
    assert list(tables) == ["input_cost"]
    assert [row[0] for row in rows_in(tables["input_cost"].body)] == ["Q", "R, $c=10^{-1}$"]


TIME = MetricInfo("settling_time", "s", "lower")
FAST = Requirement("settling_time < 20", "settling_time", (Limit("<", 20.0),))


def passing(make_trials, requirements=(FAST,)):
    """Statistics of two methods: one run of A and three of B pass, and one run of B fails."""
    columns = {"settling_time": {"A": [10.0, 30.0, 30.0, 30.0], "B": [10.0, 11.0, 12.0, "diverged"]}}
    return summarise(replace(make_trials(columns, (TIME,)), requirements=requirements))


def test_the_table_of_requirements(make_trials):
    """Rows are those of the pass rates, the caption defines the columns; without requirements there is none."""
    made = latex_tables(passing(make_trials), ["version 1"])["requirements"]
    text, words = made.body, "".join(made)
    assert text.startswith("% version 1") and r"settling\_time $<$ 20 s" in text
    assert "A & $1/4$ & " in text and "B & $3/4$ & " in text and "$+50" in text and r"\toprule" in text
    assert r"settling\_time $<$ 20 s; 4 runs per method" in words and "B 1; they do not pass" in words
    assert "Wilson" in words and "percentage points" in words
    assert "requirements" not in latex_tables(passing(make_trials, ()))
