"""Summary of the metrics, and numbers as texts."""

import math

import numpy as np
import pytest
from data_frames import summary_frame

INF = math.inf


def only(table):
    """Return the single row."""
    assert len(table) == 1
    return table.iloc[0]


def test_summary_by_hand(make_trials):
    """1..5 and one failed run."""
    table = summary_frame(make_trials({"mse": {"A": [5.0, 1.0, None, 3.0, 2.0, 4.0]}}))
    columns = "method,metric,n,n_failed,mean,se,ci_low,ci_high,median,q25,q75,min,max,did_not_occur"
    assert ",".join(table.columns) == columns
    row = only(table)
    assert (row.n, row.n_failed, row["mean"], row["median"], row.q25, row.q75) == (5, 1, 3, 3, 2, 4)
    assert (row["min"], row["max"], row.did_not_occur) == (1, 5, 0)
    assert row.se == pytest.approx(math.sqrt(2.5 / 5), rel=1e-12)
    # 2.776445105198 is the tabulated t(0.975, 4).
    assert (row.ci_low, row.ci_high) == pytest.approx((3 - 2.776445105198 * row.se, 3 + 2.776445105198 * row.se))


def test_summary_of_an_event_that_may_not_occur_has_no_mean(make_trials):
    """Share and median remain."""
    row = only(summary_frame(make_trials({"settling": {"A": [1.0, INF, 2.0, INF, INF]}})))
    assert np.isnan([row["mean"], row.se, row.ci_low, row.ci_high]).all()
    assert (row["median"], row.q25, row["max"], row.did_not_occur, row.n) == (INF, 2, INF, 3, 5)


def test_one_run_and_no_run(make_trials):
    """No crash, no warning, no interval."""
    table = summary_frame(make_trials({"mse": {"A": [2.0], "B": [None]}}))
    assert (table["n"].tolist(), table["n_failed"].tolist()) == ([1, 0], [0, 1])
    assert table["mean"][0] == 2
    assert table[["se", "ci_low", "ci_high"]].isna().all(axis=None)
    assert math.isnan(table["median"][1])


def test_huge_values_do_not_warn(make_trials):
    """Runs on the way to divergence."""
    trials = make_trials({"mse": {"A": [1e300, 1e308, 1.7e308], "B": [1.0, 2.0, 1e-300]}})
    assert summary_frame(trials)["median"][0] == 1e308
