"""Markdown page."""

import math
from dataclasses import replace

import pytest

from rmpc_bench.analysis.comparison import comparisons
from rmpc_bench.analysis.statistics import summary
from rmpc_bench.report.summary import summary_markdown
from rmpc_bench.types import MetricInfo

INF = math.inf
SETTLING = MetricInfo("settling_time", "s", "lower")
OFFSET = MetricInfo("offset", "", "zero")


def page(trials):
    return summary_markdown(trials, summary(trials), comparisons(trials))


def cells(text, start):
    """Return the cells of the only line of a Markdown table that starts with `start`."""
    (line,) = [line for line in text.splitlines() if line.startswith(f"| {start} |")]
    return line.strip("| ").split(" | ")


@pytest.mark.parametrize("word", ["as published", "default"])
def test_the_note_says_where_parameters_come_from(make_trials, word):
    trials = make_trials({"mse": {"A": [1.0, 2.0, 4.0], "B": [2.0, 3.0, 8.0]}})
    alike = page(replace(trials, parameters={"A": word, "B": word}))
    assert f" Parameters: {word}, not tuned." in alike
    mixed = replace(trials, parameters={"A": word, "B": "tuned (budget 16, 40 runs)"})
    assert f" Parameters: A {word}, not tuned; B tuned." in page(mixed)


def test_an_event_that_does_not_occur_has_a_count_and_a_median_but_no_mean(make_trials):
    values = {"A": [1.0, 2.0, 3.0, 4.0], "B": [1.0, INF, INF, INF], "C": ["diverged"] * 4}
    text = page(make_trials({"settling_time": values}, [SETTLING]))
    assert "| method | occurred; median settling time [s] |" in text and cells(text, "A")[1] == "4 of 4; 2.5"
    assert cells(text, "B")[1] == "1 of 4; -" and "inf (inf, inf)" in cells(text, "B")


@pytest.mark.parametrize(
    ("values", "shown"),
    [
        ([2.0] * 5, "2 (2, 2)"),
        ([0.0] * 5, "0 (0, 0)"),
        ([1.0, 2.0, 3.0, 4.0, 5.0], "3.0 (2.0, 4.0)"),
        ([1e-9, 2e-9, 3e-9, 4e-9, 5e-9], "3e\u22129 (2e\u22129, 4e\u22129)"),
        ([1e7, 2e7, 3e7, 4e7, 5e7], "3e7 (2e7, 4e7)"),
        ([1.0, 2.0, 3.0, INF, INF], "3.0 (2.0, inf)"),
        # One wild quartile does not take the digits of the median.
        ([1.0, 1.1, 1.2, 1e6, 1e6], "1.20 (1.10, 1e6)"),
    ],
)
def test_digits_of_the_median(make_trials, values, shown):
    text = page(make_trials({"mse": {"A": values}}))
    assert dict(zip(cells(text, "method"), cells(text, "A"), strict=True))["median (quartiles)"] == shown


def test_markdown_page(make_trials):
    """Every part, from 4 pairs that can be checked by hand."""
    trials = make_trials(
        {
            "mse": {"A": [1.0, 2.0, 4.0, 8.0], "B|b": [1.1, 2.3, "out-of-range", 8.0]},
            "offset": {"A": [-1.0, 1.0, 2.0, 3.0], "B|b": [0.5, 0.5, 1.0, 1.0]},
        },
        [MetricInfo("mse", "rad^2", "lower"), OFFSET],
        {"B|b": "B, $c=1$"},
    )
    text = page(trials)
    assert text.startswith(
        "# tiny\n\n4 runs per method, seed 7, intervals at 95 %.\n\n## mse [rad^2], lower is better\n"
    )
    assert "\n## offset, best at 0\n" in text and "Failed runs are left out of means and changes." in text
    mse_part, offset_part = text.split("## offset")
    assert cells(mse_part, "method") == (
        ["method", "mean MSE [rad^2]", "change", "verdict", "median (quartiles)", "won/lost/tied", "superiority"]
        + ["ratio of means", "worst run", "runs needed", "p", "runs"]
    )
    # Student t on ln 1.1, ln 1.15 and ln 1: 0.0784 +- 4.303 x 0.0412.
    row = cells(mse_part, r"B\|b")
    assert row[2] == "+8 % [\u22129, +29]" and row[3] == "inconclusive 1 of 4 failed" and row[5] == "0/3/1"
    # 3 lost, the failed run among them, and half of a tie.
    assert row[6].startswith("12 % [") and row[11] == "3, 1 failed"
    assert cells(mse_part, "A")[2:4] == ["", "baseline"] and cells(offset_part, r"B\|b")[5] == "3/1/0"
    assert text.endswith(
        "## Failed runs\n\n"
        "- B|b: 1 run out-of-range: a drawn parameter or a state left the range of the plant "
        "(a mass, the length of an arm, `plant.bounds`)\n"
    )


def test_without_verdicts_sizes_and_statuses_are_all_and_oracles_are_marked(make_trials):
    """A smoke run of four runs has no verdict: a table of zeros was `not separated`.  Unknown statuses are counted."""
    trials = make_trials({"mse": {"A": [0.0, 0.0, "eaten-by-dog", "eaten-by-dog"], "S": [0.0] * 4}})
    trials = replace(trials, with_verdicts=False)
    text = page(trials)
    assert [row["verdict"] for row in comparisons(trials)] == [""]
    assert not any(word in text for word in ("change", "superiority", "verdict", "against", "equivalent"))
    assert text.endswith("## Failed runs\n\n- A: 2 runs eaten-by-dog\n")
    trials = make_trials({"mse": {"B": [2.0, 3.0, 2.6], "oracle": [1.0, 2.0, 1.5]}})
    text = page(replace(trials, oracles=frozenset({"oracle"})))
    assert "| oracle |" in text and "An oracle knows the true parameters." in text


def test_worst_runs(make_trials):
    """By hand: of the runs 1 to 40 the mean of the worst 5 % is 39.5.  An event that did not occur is the worst."""
    values = [float(value) for value in range(1, 41)]
    trials = make_trials({"mse": {"A": values, "B": values[::-1]}})
    rows = [line for line in page(trials).split("## Worst runs")[1].splitlines() if line.startswith("| mse")]
    assert [row.strip("| ").split(" | ") for row in rows] == [
        ["mse [rad^2]", "A", "38.05", "39.5", "40 (run 39)"],
        ["mse [rad^2]", "B", "38.05", "39.5", "40 (run 0)"],
    ]
    assert "## Worst runs" not in page(make_trials({"mse": {"A": values[:10]}}))
    assert "## Worst runs" not in page(replace(trials, with_verdicts=False))
    scores, times = [float(value) for value in range(1, 101)], [1.0] * 90 + [INF] * 9 + ["diverged"]
    infos = [MetricInfo("score", "", "higher"), SETTLING]
    text = page(make_trials({"score": {"A": [*scores[:99], "diverged"]}, "settling_time": {"A": times}}, infos))
    lines = text.split("## Worst runs")[1].split("## Failed runs")[0].strip().splitlines()
    score, settling = [line.strip("| ").split(" | ") for line in lines[-2:]]
    assert score[2].startswith("6 [") and score[2].endswith("(5 %)") and score[4] == "1 (run 0)"
    assert settling[2:] == ["inf", "inf", "inf (run 90)"]
