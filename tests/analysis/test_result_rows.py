"""One record per method: words, changes, order and texts from small tables of trials."""

import math
from dataclasses import replace

import numpy as np
import pytest
from comparison_tables import table as trials_of
from data_frames import arrays

from rmpc_bench.analysis.comparison import comparisons, levels
from rmpc_bench.analysis.result_rows import in_one_form, result_table
from rmpc_bench.analysis.statistics import summary

N = 60
BASE = np.exp(0.3 * np.random.default_rng(1).normal(size=N))
NOISE = np.exp(0.02 * np.random.default_rng(2).normal(size=N))


def rows_of(values, **others):
    """Return the table of result rows of the only metric, and its rows by method."""
    trials = trials_of(values, **others)
    table = result_table(trials, summary(trials), comparisons(trials, levels(trials)), trials.metrics[0])
    return table, {row.method: row for row in table.rows}


def test_words_follow_the_sign_and_the_margin():
    table, rows = rows_of(
        {"KF": BASE, "A": 0.8 * BASE * NOISE, "B": 1.4 * BASE * NOISE, "C": BASE * NOISE**0.01, "D": BASE[::-1]}
    )
    assert [row.word for row in table.rows] == ["baseline", "better", "worse", "equivalent", "inconclusive"]
    assert rows["KF"].counts == "" and sum(map(int, rows["A"].counts.split("/"))) == N
    assert table.best is rows["A"]
    assert table.form == "ratio" and table.margin == 0.01 and table.margin_text == "1 %"
    assert table.change_texts(rows["KF"]) == ("", "")


def test_a_change_is_the_average_of_the_ratios():
    table, rows = rows_of({"KF": BASE, "A": 0.8 * BASE})
    assert rows["A"].change.value == pytest.approx(-20)
    assert table.average == "geometric mean of the ratios"
    assert rows["A"].mean.value == pytest.approx(0.8 * BASE.mean())
    t = 2.000995  # 97.5 % of Student's t with 59 degrees of freedom
    assert rows["KF"].mean.half == pytest.approx(t * BASE.std(ddof=1) / math.sqrt(N), rel=1e-5)


def test_a_failing_method_fails_more_and_says_how_often():
    bad = 0.9 * BASE * NOISE
    bad[::3] = math.nan
    _, rows = rows_of({"KF": BASE, "A": bad})
    assert (rows["A"].word, rows["A"].remark) == ("fails more", "20 of 60 failed")
    assert (rows["A"].n, rows["A"].n_failed) == (40, 20)


def test_a_method_whose_every_run_failed_has_no_numbers():
    table, rows = rows_of({"KF": BASE, "A": np.full(N, math.nan), "B": 0.8 * BASE * NOISE})
    assert rows["A"].word == "fails more" and rows["A"].quantiles == () and math.isnan(rows["A"].worst)
    assert table.mean_text(rows["A"]) == "" and table.change_text(rows["A"]) == ""
    assert table.best is rows["B"]


def test_an_oracle_is_last_in_no_count_and_never_the_best():
    table, rows = rows_of(
        {"KF": BASE, "oracle": 0.5 * BASE * NOISE, "A": 0.8 * BASE * NOISE}, oracles=frozenset(["oracle"])
    )
    assert [row.method for row in table.ordered] == ["KF", "A", "oracle"]
    assert [row.method for row in table.compared] == ["A"]
    assert table.best is rows["A"]


def test_more_than_six_methods_are_sorted_by_their_change():
    factors = [1.3, 0.9, 0.7, 1.1, 2.0, 0.8]
    few = {"KF": BASE, **{f"M{k}": factor * BASE * NOISE for k, factor in enumerate(factors[:5])}}
    table, _ = rows_of(few)
    assert [row.method for row in table.ordered] == ["KF", "M0", "M1", "M2", "M3", "M4"]
    table, _ = rows_of(few | {"M5": 0.8 * BASE * NOISE})
    assert [row.method for row in table.ordered] == ["M2", "M5", "M1", "KF", "M3", "M0", "M4"]


@pytest.mark.parametrize("direction", ["lower", "higher"])
def test_the_best_has_the_change_in_the_good_direction(direction):
    table, rows = rows_of({"KF": BASE, "A": 0.8 * BASE * NOISE, "B": 1.4 * BASE * NOISE}, direction=direction)
    best = "A" if direction == "lower" else "B"
    assert table.best is rows[best] and rows[best].word == "better"
    assert rows["A"].worst == (0.8 * BASE * NOISE).max() if direction == "lower" else (0.8 * BASE * NOISE).min()


def test_a_signed_metric_is_compared_by_distances_in_its_unit():
    values = np.random.default_rng(3).normal(size=N)
    table, rows = rows_of({"KF": values, "A": 0.2 * values}, direction="zero", unit="rad")
    assert table.form == "difference" and rows["A"].word == "better"
    assert rows["A"].change.value == pytest.approx(-0.8 * abs(values).mean())
    assert table.change_text(rows["A"]).startswith("−0.6") and " rad [" in table.change_text(rows["A"])
    assert table.quantity == "|m|" and table.quantity_with_unit == "|m| [rad]"


def test_an_event_is_counted_and_compared_by_shares():
    never = np.where(np.arange(N) < 42, math.inf, 5.0 + np.arange(N) / 100)
    soon = 3.0 + np.arange(N) / 100
    table, rows = rows_of({"KF": never, "A": soon}, may_not_occur=True)
    assert table.form == "share" and table.may_not_occur
    assert table.mean_text(rows["KF"]) == "18 of 60; -" and table.mean_text(rows["A"]) == "60 of 60; 3.29"
    assert rows["A"].word == "better" and table.change_text(rows["A"]).startswith("100 % [")
    assert table.rank(rows["A"]) < table.rank(rows["KF"])


def test_an_event_that_never_occurs_has_no_median():
    table, rows = rows_of({"KF": np.full(N, math.inf), "A": np.full(N, math.inf)}, may_not_occur=True)
    assert table.mean_text(rows["A"]) == "0 of 60"
    assert rows["A"].quantiles == (math.inf,) * 5 and rows["A"].word in ("equivalent", "inconclusive")


def test_a_smoke_run_says_what_ran():
    bad = BASE.copy()
    bad[0] = math.nan
    _, rows = rows_of({"KF": BASE, "A": bad}, with_verdicts=False)
    assert (rows["KF"].word, rows["A"].word, rows["A"].remark) == ("ran", "failed", "1 of 60 failed")


def test_one_method_alone():
    table, rows = rows_of({"KF": BASE})
    assert table.form == "alone" and table.best is None and rows["KF"].word == "baseline"


def test_a_method_without_rows_is_not_computed():
    trials = trials_of({"KF": BASE, "A": BASE})
    frame = trials.frame[trials.frame["method"] == "KF"]
    trials = replace(trials, columns=arrays(frame))
    table = result_table(trials, summary(trials), comparisons(trials, levels(trials)), trials.metrics[0])
    assert [row.word for row in table.rows] == ["baseline", "not computed"]
    assert table.mean_text(table.rows[1]) == ""


def test_methods_that_are_equal_are_equivalent():
    table, rows = rows_of({"KF": BASE, "A": BASE, "B": BASE.copy()})
    assert {rows["A"].word, rows["B"].word} == {"equivalent"}
    assert table.change_text(rows["A"]) == "0.0 %"


def test_remarks_of_uncertain_sizes():
    rng = np.random.default_rng(4)
    for scale in np.linspace(0.02, 0.2, 60):
        _, rows = rows_of({"KF": BASE, "A": 0.98 * BASE * np.exp(scale * rng.normal(size=N))})
        if rows["A"].compared["verdict"] == "better-size-uncertain":
            assert (rows["A"].word, rows["A"].remark) == ("better", "perhaps by less than 1 %")
            return
    raise AssertionError("no scale gave an uncertain size")


def test_averages_that_disagree_are_inconclusive():
    # Geometric mean of the ratios: 0.5^0.88 30^0.12 = 0.82; ratio of the means: 0.88 * 0.5 + 0.12 * 30 = 4.
    ratios = np.where(np.arange(2000) % 25 < 3, 30.0, 0.5)
    _, rows = rows_of({"KF": np.ones(2000), "A": ratios})
    assert rows["A"].compared["verdict"] == "depends-on-average"
    assert (rows["A"].word, rows["A"].remark) == ("inconclusive", "averages disagree")


def test_points_of_a_sweep_have_one_form():
    """A point where the baseline or the method is lost has the form of the others; a baseline of 0 makes all shares."""
    usual, lost = {"KF": BASE, "A": 0.8 * BASE * NOISE}, np.full(N, math.nan)
    tables = [rows_of(each)[0] for each in (usual, {"KF": lost, "A": BASE}, {"KF": BASE, "A": lost})]
    assert [table.form for table in in_one_form(tables)] == ["ratio"] * 3
    shown = [table.short_change(table.row_of("A")) for table in in_one_form(tables)]
    assert shown == ["\u221220 %", "better", "failed"]
    zero = rows_of({"KF": np.zeros(N), "A": BASE})[0]
    assert [table.form for table in in_one_form([tables[0], zero])] == ["share", "share"]


def test_the_worst_run_is_the_farthest_from_the_best_value():
    values = np.array([-5.0, *[1.0] * 59])
    for direction, worst in (("zero", -5.0), ("lower", 1.0), ("higher", -5.0)):
        _, rows = rows_of({"KF": values, "A": values}, direction=direction)
        assert rows["A"].worst == worst
    ratios = np.array([0.1, *[2.0] * 59])
    _, rows = rows_of({"KF": ratios, "A": ratios}, direction="one")
    assert rows["A"].worst == 0.1
