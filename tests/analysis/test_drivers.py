"""Drivers of whole tables: responses, quantities that do not count, regions, and failed runs."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from data_frames import arrays, driver_frame

from rmpc_bench.analysis.drivers import REST, gist, inputs, share_text
from rmpc_bench.analysis.intervals import student, wilson
from rmpc_bench.analysis.responses import SHARE, Response, most_failures, regions, worst_means
from rmpc_bench.report.run_tables import drivers_table

N = 100
CHANCE = 0.06
"""What two terms explain of 100 runs by chance: four standard deviations, 4 sqrt(2)/99."""


def quantities(n=N, **more):
    """A table of two uncertain quantities and others."""
    rng = np.random.default_rng(1)
    return pd.DataFrame({"run": range(n), "a": rng.uniform(-1, 1, n), "b": rng.uniform(-0.2, 0.2, n), **more})


@pytest.fixture
def made(make_trials):
    """Return a function that makes trials of a method whose log ratio to the baseline is a response of a and b."""

    def make(of=lambda a, b: -0.5 + 0.1 * a, n=N, table=None, directions=None, failed=(), inf=()):
        table = quantities(n) if table is None else table
        base = 1 + np.random.default_rng(2).uniform(0, 1, n)
        values = base * np.exp(of(table["a"].to_numpy(), table["b"].to_numpy()))
        values = [None if run in failed else np.inf if run in inf else value for run, value in enumerate(values)]
        trials = make_trials({"cost": {"new": values, "old": list(base)}}, directions=directions)
        return replace(trials, quantities=arrays(table))

    return make


def rows(frame, method):
    """Quantity -> row of one method, without the row of the failed runs."""
    chosen = frame[(frame["method"] == method) & (frame["response"] != "failed")]
    return chosen.set_index("quantity").to_dict("index")


def test_a_log_ratio_that_one_quantity_determines(made):
    """A explains all, b nothing; the baseline's own spread is explained by neither."""
    frame = driver_frame(made())
    new, old = rows(frame, "new"), rows(frame, "old")
    assert new["a"]["response"] == "log ratio"
    assert new["a"]["share"] == pytest.approx(1, abs=CHANCE)
    assert new["b"]["share"] == pytest.approx(0, abs=1e-6)
    assert new[REST]["share"] == pytest.approx(0, abs=1e-6)
    assert (old["a"]["response"], old["a"]["resolved"], old["b"]["resolved"]) == ("log", False, False)
    assert old[REST]["share"] > 0.8


def test_the_worst_fifth_is_that_of_the_largest_ratio(made):
    """With the log ratio -0.5 + 0.1 a the highest fifth of a is worst, by the mean of its 20 runs."""
    row = rows(driver_frame(made()), "new")["a"]
    a = np.sort(quantities()["a"].to_numpy())[-20:]
    low, high = student(-0.5 + 0.1 * a, 1 - 0.05 / 10)
    assert (row["worst_part"], row["worst_n"], row["worst_from"], row["worst_to"]) == ("highest", 20, a[0], a[-1])
    expected = 100 * np.expm1([(-0.5 + 0.1 * a).mean(), low, high])
    np.testing.assert_allclose([row["worst"], row["worst_low"], row["worst_high"]], expected, rtol=1e-6)  # rounded
    assert row["differs"]


def test_where_higher_is_better_the_lowest_fifth_is_worst(made):
    """The same numbers with the other direction."""
    row = rows(driver_frame(made(directions={"cost": "higher"})), "new")["a"]
    assert row["worst_part"] == "lowest"


def test_below_fifty_runs_nothing_is_resolved(made):
    """There is no share, and the row says how many runs there are."""
    row = rows(driver_frame(made(n=49, table=quantities(49))), "new")["a"]
    assert (np.isnan(row["share"]), row["resolved"], row["n"], row["worst_n"]) == (True, False, 49, 0)


@pytest.mark.parametrize(
    ("row", "text"),
    [
        ((0.79, 0.67, 0.85, True), "79 % [67, 85]"),
        ((-0.01, -0.02, 0.01, True), "0 % [0, 1]"),
        ((0.04, -0.01, 0.21, False), "- [0, 21]"),
        ((np.nan, np.nan, np.nan, False), "-"),
    ],
)
def test_a_share_is_a_number_or_a_dash(row, text):
    assert share_text(dict(zip(("share", "share_low", "share_high", "resolved"), row, strict=True))) == text


def test_failed_runs_are_left_out_and_counted(made):
    """The share rests on the runs that both finished; the region of the failures is the one where they are."""
    a = quantities()["a"].to_numpy()
    failed = set(np.flatnonzero(a > 0.8))
    frame = driver_frame(made(failed=failed))
    row = rows(frame, "new")["a"]
    assert (row["n"], row["n_failed"]) == (N - len(failed), len(failed))
    assert row["share"] == pytest.approx(1, abs=CHANCE)
    where = frame[frame["response"] == "failed"].iloc[0]
    assert (where["method"], where["quantity"], where["worst_part"]) == ("new", "a", "highest")
    assert where["overall"] == pytest.approx(len(failed))
    assert where["differs"]


def test_an_event_that_does_not_occur_is_an_indicator(made):
    """Without a mean the share of the runs without the event is explained."""
    a = quantities()["a"].to_numpy()
    row = rows(driver_frame(made(inf=set(np.flatnonzero(a > 0.5)))), "new")["a"]
    assert (row["response"], row["unit"]) == ("difference in not occurring", "percentage points")
    assert row["share"] > 0.5
    assert row["worst"] == pytest.approx(100)


def test_a_signed_metric_has_differences(made):
    """Where 0 is best there is no ratio."""
    row = rows(driver_frame(made(directions={"cost": "zero"})), "new")["a"]
    assert row["response"] == "difference"


def test_constant_and_missing_quantities_do_not_count(made):
    """One that is constant is named, one that has no values at this point is not."""
    trials = made(table=quantities(fixed=0.3, absent=np.nan))
    assert inputs(trials).constant == ("fixed",)
    assert set(rows(driver_frame(trials), "new")) == {"a", "b", REST}


def test_a_choice_of_two_values(made):
    """Each value is a region of its own."""
    table = quantities()
    table["a"] = np.where(table["a"] > 0, 1.0, -1.0)
    row = rows(driver_frame(made(table=table)), "new")["a"]
    assert row["share"] == pytest.approx(1, abs=CHANCE)
    assert (row["worst_part"], row["worst_from"], row["worst_to"]) == ("", 1.0, 1.0)


def test_methods_that_are_equal_have_nothing_to_explain(made):
    """The log ratio has no spread."""
    row = rows(driver_frame(made(of=lambda a, b: 0 * a)), "new")["a"]
    assert np.isnan(row["share"])


def test_no_uncertain_quantity_no_row(make_trials):
    """A table without uncertainty.csv has no drivers."""
    assert driver_frame(make_trials({"cost": {"new": [1.0] * N, "old": [2.0] * N}})).empty


def test_correlated_quantities_are_named():
    """More than 1/2 in absolute value."""
    trials = quantities()
    table = trials.assign(c=-trials["a"] + 0.1 * trials["b"])

    class Table:
        quantities = arrays(table)
        runs = np.arange(N)

    assert inputs(Table()).correlated == (("a", "c"),)


def test_correlated_quantities_are_not_said_to_explain_nothing(made):
    """Either explains what the other one would: the shares are 0, and one of the two decides all."""
    table = quantities()
    table["b"] = 2 * table["a"]
    found = rows(driver_frame(made(table=table)), "new")
    for name in "ab":
        assert found[name]["share_high"] < 0.05
        assert not found[name]["resolved"]


def test_the_larger_half_is_not_called_worst_for_a_few_worse_runs():
    """A value of 8 runs is no region; the other value is better than the mean of all runs, not worse."""
    a = np.where(np.arange(200) < 8, 1.0, 0.0)
    y = 10 * a + 0.01 * np.random.default_rng(0).standard_normal(200)
    worst = worst_means({"a": a}, y, 0.95)["a"]
    assert worst.interval[1] < worst.overall
    assert not worst.differs


def test_shares_of_events_have_intervals_of_shares(made):
    """All 20 runs of a fifth without the event: Student's interval would have the width 0."""
    a = quantities()["a"].to_numpy()
    frame = driver_frame(made(inf=set(np.flatnonzero(a > 0.3))))
    row = rows(frame, "new")["a"]
    assert row["unit"] == "percentage points"
    assert row["worst_low"] < row["worst"] == pytest.approx(100)
    response = Response("old", SHARE, np.ones(20))
    assert response.interval(response.values, 0.95) == wilson(20, 20, 0.95)


def test_a_fifth_has_a_fifth_of_the_runs():
    """Every run is in one region of each quantity."""
    table = quantities()
    found = list(regions({"a": table["a"].to_numpy()}))
    assert [region.inside.sum() for region in found] == [20] * 5
    assert (np.sum([region.inside for region in found], axis=0) == 1).all()


def test_the_interval_of_the_worst_fifth_covers_although_it_was_chosen():
    """Of responses without any driver the simultaneous interval misses the mean of a chosen fifth in 5 % at most."""
    rng = np.random.default_rng(0)
    missed, naive, experiments = 0, 0, 500
    for _ in range(experiments):
        values = {name: rng.uniform(size=100) for name in "abc"}
        y = rng.standard_normal(100)
        worst = max(worst_means(values, y, 0.95).values(), key=lambda each: each.mean)
        missed += not worst.interval[0] <= 0 <= worst.interval[1]
        low, high = student(y[worst.region.inside], 0.95)
        naive += not low <= 0 <= high
    assert missed / experiments <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / experiments)
    # Without the correction it would miss far more often.
    assert naive / experiments > 0.15


def test_few_failures_have_no_region():
    """Below five failed runs nothing is said."""
    failed = np.arange(100) < 4
    assert most_failures({"a": np.arange(100.0)}, failed, 0.95) is None


def test_the_gist_is_of_changes_where_there_are_others():
    """What drives the baseline itself does not drive the changes from it."""
    usual = {"quantity": "eps", "response": "log", "n": 100, "share": 0.8, "resolved": True}
    base, other = usual | {"method": "A"}, usual | {"method": "B"}
    assert gist([base], "A") == gist([base, other], "A") == "mostly eps"
    assert gist([base, other | {"resolved": False}], "A") == ""
    assert gist([base, other | {"n": 0, "share": float("nan"), "resolved": False}], "A") == ""


def test_the_table_of_drivers_says_which_quantities_are_correlated(made):
    """Oracle: c is a but for a tenth of b; two independent quantities are not named."""
    table = quantities()
    table["c"] = -table["a"] + 0.1 * table["b"]
    for given, said in ((table, True), (quantities(), False)):
        text = drivers_table(made(table=given)).to_markdown()
        assert ("a with c" in text) == said == ("Correlated" in text)
