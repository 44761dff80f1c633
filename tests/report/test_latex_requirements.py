"""The table of requirements in LaTeX: counts of the pass rates, units, and a caption that defines the columns."""

from dataclasses import replace

from rmpc_bench.report.notes import latex_tables
from rmpc_bench.report.summary import summarise
from rmpc_bench.types import MetricInfo
from rmpc_bench.types.requirement import Limit, Requirement

TIME = MetricInfo("settling_time", "s", "lower")
FAST = Requirement("settling_time < 20", "settling_time", (Limit("<", 20.0),))


def table(make_trials, requirements=(FAST,)):
    """Statistics of two methods: one run of A and three of B pass, and one run of B fails."""
    columns = {"settling_time": {"A": [10.0, 30.0, 30.0, 30.0], "B": [10.0, 11.0, 12.0, "diverged"]}}
    return summarise(replace(make_trials(columns, (TIME,)), requirements=requirements))


def test_rows_are_those_of_the_pass_rates(make_trials):
    text = latex_tables(table(make_trials), ["version 1"])["requirements"].body
    assert text.startswith("% version 1") and r"settling\_time $<$ 20 s" in text
    assert "A & $1/4$ & " in text and "B & $3/4$ & " in text and "$+50" in text and r"\toprule" in text


def test_the_caption_defines_the_columns(make_trials):
    text = "".join(latex_tables(table(make_trials))["requirements"])
    for words in (
        r"settling\_time $<$ 20 s; 4 runs per method",
        "Wilson",
        "percentage points",
        "B 1; they do not pass",
    ):
        assert words in text


def test_without_requirements_there_is_no_table(make_trials):
    assert "requirements" not in latex_tables(table(make_trials, ()))
