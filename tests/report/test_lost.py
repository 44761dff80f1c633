"""The share of lost runs beside the mean: screen, summary.md, LaTeX, page and lost.csv, also at points of a sweep."""

from dataclasses import replace

import pandas as pd
import pytest
from comparison_tables import table
from small_experiment import cli, write

from rmpc_bench import load_config
from rmpc_bench.analysis.columns import n_rows
from rmpc_bench.report.notes import latex_tables
from rmpc_bench.report.run_tables import lost_table
from rmpc_bench.report.summary import summarise
from rmpc_bench.types import ConfigError, MetricInfo

SHARE = "25 % [5, 70]"
"""One of four runs; its Wilson interval is [4.56, 69.94]."""


@pytest.fixture
def trials():
    """Return a table of a baseline and of a method that loses one of its four runs without failing."""
    return table({"KF": [1.0, 1.1, 0.9, 1.0], "X": [1.0, 50.0, 0.9, 1.2]}, lost=10.0)


def test_the_markdown_has_the_share_in_the_table_of_the_primary_metric(trials, make_trials):
    page = summarise(trials).to_markdown()
    assert "| lost |" in page and f"| {SHARE} |" in page
    without = replace(trials, lost=None)
    assert "| lost |" not in summarise(without).to_markdown() and not n_rows(lost_table(without))
    assert not any("Lost" in text for text in latex_tables(summarise(without))["m"])
    values = {"KF": [1.0, 1.0], "X": [1.0, 50.0]}
    infos = (MetricInfo("mse", "", "lower"), MetricInfo("cost", "", "lower"))
    made = replace(make_trials({"mse": values, "cost": values}, infos), primary="cost", lost=10.0)
    pages = summarise(made).to_markdown().split("\n## ")
    assert ["| lost |" in page for page in pages[1:3]] == [False, True]


def test_tables_for_a_paper_and_points_of_a_sweep(trials, make_sweep):
    made = summarise(trials)
    text = latex_tables(made, width=100.0)["m"].body
    assert r"Lost\\{}[\%]" in text and r"$25\ [5, 70]$" in text and "Change" in text and "Won/lost" not in text
    note = latex_tables(made)["m"].note
    assert r"Lost: share of the runs that failed or whose m exceeds 10 times that of KF in the same run" in note
    assert r"$25\ [5, 70]$" in latex_tables(made.shown(["X"]), columns=["lost"])["m"].body
    points = [({"s": text}, replace(trials, title=f"s={text}", lost=lost)) for text, lost in (("1", 10.0), ("2", 60.0))]
    found = pd.DataFrame(lost_table(make_sweep(*points)))[["s", "method", "n_lost"]].to_numpy().tolist()
    assert found == [["1", "KF", 0], ["1", "X", 1], ["2", "KF", 0], ["2", "X", 0]]


def test_a_run_writes_the_shares(tmp_path):
    """From the configuration to lost.csv, summary.md and the page; the columns of the other files stay."""
    methods = "{S-MPC: {estimator: {kind: kalman}}, R-MPC: {estimator: {kind: robust-kalman, c: 0.1}}}"
    plain, counted = tmp_path / "plain", tmp_path / "counted"
    path = write(tmp_path, methods=methods)
    for out, options in ((plain, ()), (counted, ("--set", "statistics.lost=1.0000001"))):
        result = cli("run", path, "-o", out, "-j", 1, "--progress", "none", *options)
        assert result.exit_code == 0, result.output
    assert " lost (failed, or MSE above 1 times that of S-MPC): 0 (S-MPC), " in result.stdout
    mse = pd.read_csv(plain / "trials.csv").pivot_table(index="run", columns="method", values="mse")
    found = pd.read_csv(counted / "lost.csv").set_index("method")
    assert found.loc["R-MPC", "n_lost"] == (mse["R-MPC"] > 1.0000001 * mse["S-MPC"]).sum()
    assert found["n"].tolist() == [6, 6] and found.loc["S-MPC", "n_lost"] == 0
    assert not (plain / "lost.csv").exists()
    for name in ("summary.csv", "trials.csv"):
        assert (plain / name).read_bytes() == (counted / name).read_bytes()
    one, other = (pd.read_csv(place / "comparisons.csv") for place in (plain, counted))
    lost = [name for name in one.columns if "far_worse_" in name]
    pd.testing.assert_frame_equal(one.drop(columns=lost), other.drop(columns=lost))
    assert (one.loc[0, "far_worse_runs"], other.loc[0, "far_worse_runs"]) == (0, found.loc["R-MPC", "n_lost"])
    assert "| lost |" in (counted / "tables" / "summary.md").read_text()
    assert '<th scope="col" class="n more"><div>lost</div>' in (counted / "report.html").read_text()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ("{primary: inside, lost: 10}", "a run is lost where inside is large, but a larger one is better"),
        ("{primary: nees, lost: 10}", "a run is lost where nees is large, but it is best at 1"),
        ("{lost: 1}", "must be > 1"),
    ],
)
def test_a_metric_of_which_less_is_not_better_and_a_factor_below_one_are_refused(tmp_path, changes, message):
    with pytest.raises(ConfigError, match=f"statistics.lost: {message}"):
        load_config(write(tmp_path, metrics="[mse, inside, nees]", statistics=changes))
