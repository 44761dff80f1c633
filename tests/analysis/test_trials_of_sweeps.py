"""The table of a sweep: its points, all of them together, and the verbs of the Python API."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from data_frames import arrays
from small_experiment import ran, write

from rmpc_bench import load_config, load_trials, run, summarise

HP, C = "controller.Hp", "methods.R-MPC.estimator.c"
SWEEP = f"{{grid: {{{HP}: [10, 12], {C}: [0.1, 1]}}}}"
ZIP = f"{{zip: {{name: [short, long], {HP}: [10, 12], seed: [7, 8]}}}}"


@pytest.fixture
def sweep(make_trials):
    """Return a function that joins tables, one per value of `c`, as a sweep."""

    def make(*columns, keys=None, alike=True):
        tables = []
        for number, column in enumerate(columns):
            table = replace(make_trials({"mse": column}), point={"c": str(number)}, title=f"c={number}")
            tables.append(replace(table, keys=keys[number]) if keys else table)
        frame = pd.concat([table.frame.assign(c=table.point["c"]) for table in tables], ignore_index=True)
        columns_first = ["c", *tables[0].frame.columns]
        return replace(
            tables[0],
            columns=arrays(frame[columns_first]),
            paths=("c",),
            points=tuple(tables),
            point={},
            title="",
            alike=alike,
        )

    return make


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    """Run the small experiment at four points and return what the Python API gives."""
    directory = tmp_path_factory.mktemp("api")
    return run(load_config(write(directory, sweep=SWEEP)), directory=directory / "out", jobs=1).trials


def test_each_point_or_the_table_itself(make_trials, sweep):
    """What is asked of single runs is asked of these."""
    plain = make_trials({"mse": {"A": [1.0]}})
    assert plain.each == (plain,) and plain.title == ""
    there = sweep({"A": [1.0]}, {"A": [2.0]})
    assert there.each == there.points and [table.title for table in there.each] == ["c=0", "c=1"]


def test_pooled_runs_are_numbered_on(sweep):
    """From point to point, so that pairs stay pairs, where points have different runs, too."""
    there = sweep({"A": [1.0, 2.0], "B": [3.0, 4.0]}, {"A": [5.0, None, 7.0], "B": [8.0, 9.0, 10.0]})
    pooled = there.pooled()
    assert pooled.runs.tolist() == [0, 1, 3, 4, 5]
    np.testing.assert_array_equal(pooled.column("mse", "A"), [1, 2, 5, np.nan, 7])
    np.testing.assert_array_equal(pooled.column("mse", "B"), [3, 4, 8, 9, 10])
    a, b = pooled.pairs("mse", "A", "B")
    assert (a.tolist(), b.tolist()) == ([1, 2, 5, 7], [3, 4, 8, 10])
    assert pooled.n_failed("A") == 1 and pooled.each == (pooled,) and pooled.paths == ()
    assert "c" not in pooled.frame and pooled.title == "all 2 points together"
    assert there.frame["run"].max() == 2  # which stays as it is


def test_which_points_are_a_population(sweep):
    """Not those that share trials, which would count twice, nor those with different methods."""
    tables = [{"A": [1.0], "B": [2.0]}] * 2
    own = [{"A": "1", "B": "2"}, {"A": "3", "B": "4"}]
    assert sweep(*tables, keys=own).is_population
    assert not sweep(*tables, keys=own, alike=False).is_population
    assert not sweep(*tables, keys=[own[0], {"A": "3", "B": "2"}]).is_population
    assert sweep(*tables, keys=[own[0], {"A": "2", "B": "1"}]).is_population  # another method's


def test_the_table_of_a_run(trials):
    """Sweep columns as text first, then every method at every point, sorted as the sweep and the configuration are."""
    assert trials.paths == (HP, C) and trials.methods == ("S-MPC", "R-MPC")
    assert [*trials.frame.columns] == [HP, C, "method", "run", "status", "mse", "input_power"]
    keys = list(trials.frame[[HP, C, "method", "run"]].itertuples(index=False, name=None))
    assert keys == [
        (hp, c, method, i) for hp in ("10", "12") for c in ("0.1", "1") for method in trials.methods for i in range(6)
    ]
    assert [dict(point.point) for point in trials.points] == [
        {HP: hp, C: c} for hp in ("10", "12") for c in ("0.1", "1")
    ]
    assert [point.title for point in trials.points][1] == f"{HP}=10, {C}=1"
    for point in trials.points:
        part = trials.frame[(trials.frame[HP] == point.point[HP]) & (trials.frame[C] == point.point[C])]
        expected = part.drop(columns=[HP, C]).reset_index(drop=True)
        assert point.frame.equals(expected) and [*point.frame.columns] == [*expected.columns]


def test_points_share_what_does_not_depend(trials):
    """S-MPC has the same trials for both values of c, R-MPC its own at every point."""
    assert not trials.is_population
    keys = [point.keys for point in trials.points]
    assert len({key["S-MPC"] for key in keys}) == 2 and len({key["R-MPC"] for key in keys}) == 4
    np.testing.assert_array_equal(*(trials.points[i].column("mse", "S-MPC") for i in (0, 1)))
    assert (trials.points[0].column("mse", "R-MPC") != trials.points[1].column("mse", "R-MPC")).any()


def test_series_of_a_point_and_of_all(trials):
    """At a point every series is whole; in the table of all each stands once, with empty columns."""
    P = [point.matrix_series("P", "R-MPC") for point in trials.points]
    np.testing.assert_array_equal(P[0], P[2])
    assert P[0].shape == (11, 4, 4) and (P[0] != P[1]).any()
    series = trials.series[(trials.series["method"] == "R-MPC") & (trials.series["quantity"] == "P")]
    assert [*series.columns[:3]] == [HP, C, "method"] and set(series[HP]) == {""}
    assert len(series) == 2 * 11 * 16
    one = series[series[C] == "1"].reset_index(drop=True)
    np.testing.assert_array_equal(one[one["component"] == "1,2"]["value"], P[1][:, 1, 2])


def test_load_trials_of_a_sweep(tmp_path, trials):
    """What `rmpc-bench run` has stored is what the API returns; summaries go along."""
    ran(write(tmp_path, sweep=SWEEP), tmp_path / "out")
    loaded = load_trials(tmp_path / "out")
    assert loaded.frame.equals(trials.frame) and loaded.series.equals(trials.series)
    assert summarise(loaded).described.equals(summarise(trials).described)
    page = summarise(loaded).to_markdown()
    assert page.count("# tiny: ") == 4 and f"# tiny: {HP}=12, {C}=1\n" in page


def test_named_points(tmp_path):
    """The names of a zip are a column and the title; paths and values stand beside them."""
    trials = run(load_config(write(tmp_path, sweep=ZIP)), directory=tmp_path / "out", jobs=1).trials
    assert [point.title for point in trials.points] == ["short", "long"]
    assert trials.paths == ("name", HP, "seed") and not trials.alike
    assert [*trials.frame.columns[:4]] == ["name", HP, "seed", "method"]
    assert trials.points[1].point == {"name": "long", HP: "12", "seed": "8"}
    assert [point.seed for point in trials.points] == [7, 8]
    assert trials.pooled().column("mse", "S-MPC").tolist() == [
        value for point in trials.points for value in point.column("mse", "S-MPC")
    ]
