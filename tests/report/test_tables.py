"""Screen, Markdown page and CSV files."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from rmpc_bench.analysis.comparison import comparisons
from rmpc_bench.analysis.statistics import summary
from rmpc_bench.report.csv_file import write_csv
from rmpc_bench.report.summary import trials_csv
from rmpc_bench.report.tables import screen, summary_markdown
from rmpc_bench.types import MetricInfo

INF = math.inf
SETTLING = MetricInfo("settling_time", "s", "lower")
OFFSET = MetricInfo("offset", "", "zero")


def on_screen(trials, metric="mse"):
    return screen(trials, summary(trials), comparisons(trials), metric)


def page(trials):
    return summary_markdown(trials, summary(trials), comparisons(trials))


def cells(text, start):
    """Return the cells of the only line of a Markdown table that starts with `start`."""
    (line,) = [line for line in text.splitlines() if line.startswith(f"| {start} |")]
    return line.strip("| ").split(" | ")


def test_screen_looks_like_the_specification(make_trials):
    """The block of the product page, byte by byte, from tables with its numbers."""
    trials = make_trials({"mse": {"S-MPC": [0.1] * 200, "R-MPC1": [0.1] * 200}})
    described, compared = summary(trials), comparisons(trials)
    names = ["mean", "se", "median", "q25", "q75"]
    described[names] = [[0.11861, 0.0015, 0.1131, 0.1011, 0.1321], [0.10541, 0.0007, 0.1021, 0.0991, 0.1101]]
    compared[["change_pct", "ci_low", "ci_high"]] = [[-10.2, -11.3, -9.0]]
    compared[["won", "tied", "n_pairs"]] = [[162, 38, 200]]
    compared["verdict"] = "better"
    assert screen(trials, described, compared, "mse").splitlines() == [
        "mse [rad^2]     mean        median [quartiles]       change vs S-MPC          won/lost/tied",
        "S-MPC          0.1186(15)   0.113 [0.101, 0.132]     -                        -",
        "R-MPC1         0.1054(7)    0.102 [0.099, 0.110]    -10.2 % [-11.3, -9.0]     162/0/38        better",
        "200 paired runs; change = geometric mean of the paired ratios, 95 % interval; tied = within 1 %; "
        "failed or 10 times worse than the partner: 0 of 200 runs, so at most 1.5 % of all runs (95 % bound); "
        "(15) = standard error of the last digits",
    ]


@pytest.mark.parametrize("word", ["as published", "default"])
def test_the_legend_names_a_baseline_that_is_not_tuned(make_trials, word):
    """One text where no method is tuned; a column, the protocol and the word of the baseline where one is."""
    trials = make_trials({"mse": {"A": [1.0, 2.0, 4.0], "B": [2.0, 3.0, 8.0]}})
    alike = on_screen(replace(trials, parameters={"A": word, "B": word}))
    assert alike.endswith(f"; parameters: {word}, not tuned") and "parameters " not in alike.splitlines()[0]
    words = {"A": word, "B": "tuned (budget 16, 40 runs)"}
    mixed = replace(trials, parameters=words)
    head, first, second, legend = on_screen(mixed).splitlines()
    place = head.index("parameters")
    assert first[place:].startswith(f"{word} ") or first[place:] == word
    assert second[place:].startswith("tuned ")
    assert legend.endswith(f"; tuned = budget 16, 40 runs; A: {word}, not tuned")
    assert cells(page(mixed), "A")[1] == word and cells(page(mixed), "B")[1] == "tuned"
    tuned = on_screen(replace(trials, parameters=dict.fromkeys("AB", words["B"])))
    assert tuned.endswith("; parameters: tuned (budget 16, 40 runs)")


def test_screen_with_failed_runs_and_long_names(make_trials):
    """The pair is lost, both counts are shown, columns stay below each other."""
    trials = make_trials({"mse": {"a baseline with a name": [1.0, 2.0, 4.0], "B": [2.0, "diverged", 8.0]}})
    head, first, second, legend = on_screen(trials).splitlines()
    for text, row in (("mean", second), ("median", first), ("won/lost/tied", second), ("n/n_failed", first)):
        assert row[head.index(text) - 2] == " "
    assert first[head.index("n/n_failed") :].split() == ["3/0", "-"]
    assert second[head.index("won/lost/tied") :].split()[:4] == ["0/3/0", "2/1", "2", "inconclusive"]
    assert second[head.index("change") - 1 :].startswith("+100 % [+100, +100]  ")
    assert legend.startswith("2 paired runs; change = ") and legend.endswith(
        "; (9) = standard error of the last digits"
    )


def test_screen_of_a_single_method_and_run(make_trials):
    """Nothing to compare, no error, hence no legend."""
    lines = on_screen(make_trials({"mse": {"A": [0.125]}})).splitlines()
    assert [line.split() for line in lines] == [
        ["mse", "[rad^2]", "mean", "median", "[quartiles]"],
        ["A", "0.125", "0.125", "[0.125,", "0.125]"],
    ]


def test_an_event_that_does_not_occur_has_a_share_and_a_median_but_no_mean(make_trials):
    """Also for a method that has a mean."""
    values = {"A": [1.0, 2.0, 3.0, 4.0], "B": [1.0, INF, INF, INF], "C": ["diverged"] * 4}
    trials = make_trials({"settling_time": values}, [SETTLING])
    head, *rows, legend = on_screen(trials, "settling_time").splitlines()
    assert head.split()[:5] == ["settling_time", "[s]", "did", "not", "occur"] and "mean" not in head
    assert rows[0].split()[1:4] == ["0/4", "(0", "%)"]
    assert rows[1].split()[1:7] == ["3/4", "(75", "%)", "inf", "[inf,", "inf]"]
    assert rows[2].split()[:8] == ["C", "-", "-", "-", "0/4/0", "0/4", "0", "inconclusive"]
    assert legend == (
        "0 to 4 paired runs; tied = within 1 %; failed or 10 times worse than the partner: 3 of 4 runs of B, so at "
        "most 98.7 % of all runs (95 % bound), and 4 of 4 runs of C"
    )
    text = page(trials)
    assert "| method | did not occur | median [quartiles] |" in text
    assert cells(text, "B")[1:4] == ["3/4 (75 %)", "inf [inf, inf]", "-"]


@pytest.mark.parametrize(
    ("values", "shown"),
    [
        ([2.0] * 5, "2 [2, 2]"),
        ([0.0] * 5, "0 [0, 0]"),
        ([0.1, 0.1 + 2e-17, 0.1 - 2e-17, 0.1 - 2e-17], "0.1 [0.1, 0.1]"),
        ([1.0, 2.0, 3.0, 4.0, 5.0], "3.0 [2.0, 4.0]"),
        ([1e-9, 2e-9, 3e-9, 4e-9, 5e-9], "3.0e-09 [2.0e-09, 4.0e-09]"),
        ([1e7, 2e7, 3e7, 4e7, 5e7], "3.0e+07 [2.0e+07, 4.0e+07]"),
        ([1.0, 2.0, 3.0, INF, INF], "3.0 [2.0, inf]"),
        # One wild quartile does not take the digits of the median.
        ([1.0, 1.1, 1.2, 1e6, 1e6], "1.2 [1.1, 1.0e+06]"),
        ([-0.01, -0.01, 0.0, 1.0, 1.0], "0.00 [-0.01, 1.00]"),
        ([1e300, 1e308, 1.7e308], "1.00e+308 [0.50e+308, 1.35e+308]"),
    ],
)
def test_digits_of_the_median(make_trials, values, shown):
    """No more than its error supports, and never fewer than tell it from 0."""
    assert cells(page(make_trials({"mse": {"A": values}})), "A")[2] == shown


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
    assert "\n## offset, best at 0\n" in text and "comparisons are those of the magnitudes" in text
    assert (
        "- B|b changes mse by +8 % [-9, +29] against A (geometric mean of the ratios, 3 paired runs, 95 % interval; "
        "won 0, lost 3, tied 1); B|b alone failed in 1: inconclusive (runs needed: about "
    ) in text
    mse_part, offset_part = text.split("## offset")
    assert cells(mse_part, "method") == (
        ["method", "label", "mean", "median [quartiles]", "geometric mean of the paired ratios vs A"]
        + ["ratio of the means vs A", "won/lost/tied", "superiority", "p", "verdict", "n/n_failed", "pairs"]
    )
    # Student t on ln 1.1, ln 1.15 and ln 1: 0.0784 +- 4.303 x 0.0412.
    row = cells(mse_part, r"B\|b")
    assert row[1] == "B, $c=1$" and row[6] == "0/3/1" and row[10:] == ["3/1", "3"]
    # 3 lost, the failed run among them, and half of a tie.
    assert row[7].startswith("12 % [")
    assert cells(mse_part, "A")[4:] == ["-", "-", "-", "-", "-", "-", "4/0", "-"]
    assert cells(offset_part, r"B\|b")[5] == "3/1/0"
    assert text.endswith(
        "## Failed runs\n\n"
        "- B|b: 1 run out-of-range: a drawn parameter or a state left the range of the plant "
        "(a mass, the length of an arm, `plant.bounds`)\n"
    )


def test_unknown_status_is_counted(make_trials):
    """A table written by a later version."""
    text = page(make_trials({"mse": {"A": ["eaten-by-dog", "eaten-by-dog", 1.0]}}))
    assert text.endswith("## Failed runs\n\n- A: 2 runs eaten-by-dog\n")


def test_trials_csv(make_trials, tmp_path):
    """Missing is empty, infinite is inf, columns in order."""
    trials = make_trials({"mse": {"A": [0.1, "diverged"], "B": [INF, 1e-7]}})
    trials.frame.insert(0, "extra", 1)
    trials_csv(trials, tmp_path / "trials.csv")
    expected = b"method,run,status,mse\nA,0,ok,0.1\nA,1,diverged,\nB,0,ok,inf\nB,1,ok,1e-07\n"
    assert (tmp_path / "trials.csv").read_bytes() == expected


def test_csv_round_trip(tmp_path):
    """Floats of every size come back bit for bit in their shortest form, ints stay ints."""
    bits = np.random.default_rng(0).integers(0, 2**64, 5000, dtype=np.uint64)
    value = bits.view(np.float64)
    frame = pd.DataFrame({"method": "A, b", "component": "0,1", "k": np.arange(5000), "value": value})
    frame.loc[7, "value"] = 5e-324
    path = tmp_path / "series.csv"
    write_csv(frame, path)
    texts = [line.rsplit(",", 1)[1] for line in path.read_text().splitlines()[1:]]
    assert texts == ["" if math.isnan(number) else repr(number) for number in frame["value"].tolist()]
    # The default parser of pandas may miss the last bit, float() does not.
    back = pd.read_csv(path, dtype={"value": str}).astype({"value": float})
    pd.testing.assert_frame_equal(back, frame, check_exact=True)
    assert back["k"].dtype == np.int64
    write_csv(back, tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == path.read_bytes()
    assert b"\r" not in path.read_bytes()


def test_csv_of_the_derived_tables(make_trials, tmp_path):
    """Their columns, and no index."""
    trials = make_trials({"mse": {"A": [1.0, 2.0], "B": [2.0, "diverged"]}})
    write_csv(summary(trials), tmp_path / "summary.csv")
    write_csv(comparisons(trials), tmp_path / "comparisons.csv")
    lines = (tmp_path / "summary.csv").read_text().splitlines()
    assert lines[0].startswith("method,metric,n,n_failed,mean,se,") and lines[2].startswith("B,mse,1,1,2.0,,,,2.0,")
    text = (tmp_path / "comparisons.csv").read_text().splitlines()[1]
    assert text.startswith("B,A,mse,100.0,,,0,2,0,0.0,1.000,1,inconclusive,geometric,")


def test_an_oracle_is_marked_on_screen_and_page(make_trials):
    """Oracle: the word, beside the method that is told what it should estimate, and what it means."""
    trials = make_trials({"mse": {"B": [2.0, 3.0, 2.6], "oracle": [1.0, 2.0, 1.5]}})
    trials = replace(trials, oracles=frozenset({"oracle"}))
    text = on_screen(trials)
    assert "oracle (oracle) " in text and "B (oracle)" not in text
    assert "an oracle knows the true parameters" in text
    assert "| oracle (oracle) |" in page(trials)


def test_an_enormous_change_has_an_exponent(make_trials):
    """Oracle: the digits fit into the column; 1e101 against 50 would have a hundred of them."""
    text = on_screen(make_trials({"mse": {"B": [50.0, 60.0, 55.0], "A": [1e101, 3e101, 2e101]}}))
    assert max(map(len, text.split("\n")[:-1])) < 200
    assert "e+101 % [" in text


def test_averages_that_contradict_each_other_are_both_shown(make_trials):
    """A mean of 0.299 below 0.302 beside +4.5 % misled: the heads say which average a change is, and both are there."""
    base = np.resize([0.1, 0.2, 0.3, 3.0], 80)
    trials = make_trials({"mse": {"S": base, "A": base * np.where(base > 1, 0.7, 1.3)}})
    head, _, row, legend = on_screen(trials).splitlines()
    assert "ratio of the means" in head and "change = geometric mean of the paired ratios" in legend
    assert row[head.index("change") - 1 :].startswith("+11.4") and row[head.index("ratio") - 1 :].startswith("-20.0")
    assert row.endswith("depends on the average")
    alike = make_trials({"mse": {"S": base, "A": base * np.linspace(1.1, 1.3, 80)}})
    assert "ratio of the means" not in on_screen(alike)


def test_without_verdicts_sizes_and_statuses_are_all(make_trials):
    """A smoke run of four runs has no verdict: a table of zeros was `not separated`."""
    trials = make_trials({"mse": {"A": [0.0, 0.0, 0.0, "diverged"], "S": [0.0] * 4}})
    trials = replace(trials, with_verdicts=False)
    head, *rows = on_screen(trials).splitlines()
    assert head.split() == ["mse", "[rad^2]", "n/n_failed"]
    assert [row.split() for row in rows[:2]] == [["A", "3/1"], ["S", "4/0"]]
    assert rows[2].startswith("- A: 1 run diverged")
    text = page(trials)
    assert comparisons(trials)["verdict"].tolist() == [""]
    assert not any(word in text for word in ("change", "superiority", "verdict", "against", "equivalent"))


def test_worst_runs_stand_on_the_page(make_trials):
    """By hand: the worst of 40 runs with the values 1 to 40 is run 39; the mean of the worst 5 %, two runs, is 39.5."""
    values = [float(value) for value in range(1, 41)]
    trials = make_trials({"mse": {"A": values, "B": values[::-1]}})
    rows = [line for line in page(trials).split("## Worst runs")[1].splitlines() if line.startswith("| mse")]
    assert [row.strip("| ").split(" | ") for row in rows] == [
        ["mse [rad^2]", "A", "38", "39.5", "40 (run 39)"],
        ["mse [rad^2]", "B", "38", "39.5", "40 (run 0)"],
    ]
    assert "## Worst runs" not in page(make_trials({"mse": {"A": values[:10]}}))
    assert "## Worst runs" not in page(replace(trials, with_verdicts=False))


def test_worst_runs_where_higher_is_better_and_where_an_event_does_not_occur(make_trials):
    """The worst scores are the lowest; a settling time of inf is worse than any other, and a failed run has none."""
    scores, times = [float(value) for value in range(1, 101)], [1.0] * 90 + [INF] * 9 + ["diverged"]
    infos = [MetricInfo("score", "", "higher"), SETTLING]
    text = page(make_trials({"score": {"A": [*scores[:99], "diverged"]}, "settling_time": {"A": times}}, infos))
    lines = text.split("## Worst runs")[1].split("## Failed runs")[0].strip().splitlines()
    score, settling = [line.strip("| ").split(" | ") for line in lines[-2:]]
    assert score[2].startswith("5.9 [") and score[2].endswith("(5 %)") and score[4] == "1 (run 0)"
    assert settling[2:] == ["inf", "inf", "inf (run 90)"]


def test_a_signed_metric_without_a_margin_has_ties_of_equal_runs(make_trials):
    """Not "within 0"."""
    trials = make_trials({"offset": {"A": [1.0, 2.0, 3.0], "B": [1.0, 1.0, 2.0]}}, [OFFSET])
    assert "; tied = equal;" in on_screen(trials, "offset")
