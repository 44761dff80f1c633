"""The table of trials."""

from dataclasses import replace

import numpy as np
import pytest
from data_frames import arrays

from rmpc_bench.analysis.columns import Series, n_rows, series_columns


def test_failed_and_absent_runs_are_nan(make_trials):
    """Columns cover all runs of the table, whatever a method has."""
    trials = make_trials({"mse": {"A": [1.0, None, 3.0], "B": [4.0, 5.0, 6.0]}})
    np.testing.assert_array_equal(trials.column("mse", "A"), [1, np.nan, 3])
    trials = replace(trials, columns=arrays(trials.frame.iloc[:-1]))
    np.testing.assert_array_equal(trials.column("mse", "B"), [4, 5, np.nan])


def test_a_status_counts_even_where_a_number_was_left(make_trials):
    """A value of a failed run is never used."""
    trials = make_trials({"mse": {"A": [1.0, 2.0], "B": [4.0, 5.0]}})
    trials.columns["status"][0] = "out-of-range"
    np.testing.assert_array_equal(trials.column("mse", "A"), [np.nan, 2])
    assert (trials.n_failed("A"), trials.n_failed("B")) == (1, 0)


def test_pairs_need_both(make_trials):
    """A failed run loses its pair."""
    trials = make_trials({"mse": {"A": [1.0, None, 3.0, 4.0], "B": [5.0, 6.0, None, 8.0]}})
    a, b = trials.pairs("mse", "A", "B")
    assert (a.tolist(), b.tolist()) == ([1, 4], [5, 8])


def test_series_are_assembled_with_axis_0_k(make_trials):
    """Scalars, vectors and matrices, rows in any order."""
    values = np.arange(12.0).reshape(3, 2, 2)
    rows = [("A", "P", f"{i},{j}", k, 0, values[k, i, j]) for k in (2, 0, 1) for j in (1, 0) for i in (0, 1)]
    rows += [("A", "b", str(i), k, 0, 10 * k + i) for k in range(2) for i in range(3)]
    rows += [("A", "theta", "", k, 0, k / 4) for k in range(4)]
    trials = make_trials({"mse": {"A": [1.0]}}, rows)
    np.testing.assert_array_equal(trials.matrix_series("P", "A"), values)
    np.testing.assert_array_equal(trials.matrix_series("b", "A"), [[0, 1, 2], [10, 11, 12]])
    np.testing.assert_array_equal(trials.matrix_series("theta", "A"), [0, 0.25, 0.5, 0.75])


def test_the_exact_series_counts(make_trials):
    """Where n = 0 exists, estimates from runs are left aside."""
    rows = [("A", "v", "", k, n, value) for k in range(2) for n, value in ((500, 9.0), (0, 1.0))]
    trials = make_trials({"mse": {"A": [1.0]}}, rows)
    assert trials.matrix_series("v", "A").tolist() == [1, 1]


def test_an_absent_series_is_a_key_error(make_trials):
    """The message names method and quantity."""
    with pytest.raises(KeyError, match="A has no series M"):
        make_trials({"mse": {"A": [1.0]}}).matrix_series("M", "A")


def test_the_number_of_runs_behind_a_series(make_trials):
    """0 where it is exact, else that of its rows; of an absent one 0."""
    rows = [("A", "v", "", 0, n, 1.0) for n in (500, 0)] + [("A", "w", "", 0, 500, 1.0)]
    trials = make_trials({"mse": {"A": [1.0]}}, rows)
    assert [trials.n_of(name, "A") for name in ("v", "w", "z")] == [0, 500, 0]


def test_points_without_runs_are_no_population(make_trials):
    """Oracle: a population has one run at every point; exact moments alone have none."""
    one = make_trials({"mse": {"A": [1.0]}})
    none = replace(one, columns=arrays(one.frame.iloc[:0]))
    sweep = replace(one, alike=True, points=(replace(one, keys={"A": "1"}), replace(one, keys={"A": "2"})))
    assert sweep.is_population
    assert not replace(sweep, points=(replace(none, keys={"A": "1"}), replace(none, keys={"A": "2"}))).is_population


@pytest.mark.parametrize("gap", [None, 1])
def test_columns_of_shuffled_rows(make_trials, gap):
    """Rows in any order give the same columns, also where every run of a method is there."""
    trials = make_trials({"mse": {"A": [1.0, gap, 3.0], "B": [4.0, 5.0, 6.0]}})
    mixed = replace(trials, columns=arrays(trials.frame.iloc[[4, 2, 0, 5, 1, 3]]))
    for method in trials.methods:
        np.testing.assert_array_equal(mixed.column("mse", method), trials.column("mse", method))


def test_a_column_can_be_changed(make_trials):
    """The table keeps its numbers."""
    trials = make_trials({"mse": {"A": [1.0, 2.0], "B": [4.0, 5.0]}})
    trials.column("mse", "A")[:] = 0.0
    assert trials.column("mse", "A").tolist() == [1, 2]


def test_other_numbers_of_the_same_runs(make_trials):
    """Failed runs stay failed, and the first table stays as it was."""
    trials = make_trials({"mse": {"A": [1.0, None, 3.0], "B": [4.0, 5.0, 6.0]}})
    assert trials.column("mse", "B").tolist() == [4, 5, 6]
    doubled = trials.with_numbers(columns={**trials.columns, "mse": 2 * trials.columns["mse"]}, confidence=0.9)
    np.testing.assert_array_equal(doubled.column("mse", "A"), [2, np.nan, 6])
    assert (doubled.column("mse", "B").tolist(), doubled.confidence) == ([8, 10, 12], 0.9)
    assert trials.column("mse", "B").tolist() == [4, 5, 6]


def test_a_table_of_series_has_its_columns_without_any(make_trials):
    """By hand: a row per component and k, the columns of a sweep first; also of no sample, and of nothing."""
    matrix = Series("A", "K", np.array([[[1.0, 2.0]], [[3.0, 4.0]]]), 5, {"c": "x"})
    rows = [*zip(*series_columns([matrix, Series("A", "P", np.zeros((0, 2)), 0, {"c": ""})]).values(), strict=True)]
    assert rows[:2] == [("x", "A", "K", "0,0", 0, 5, 1.0), ("x", "A", "K", "0,0", 1, 5, 3.0)]
    assert rows[2:] == [("x", "A", "K", "0,1", 0, 5, 2.0), ("x", "A", "K", "0,1", 1, 5, 4.0)]
    names = ["method", "quantity", "component", "k", "n", "value"]
    assert [*series_columns((), ["c"])] == ["c", *names] and n_rows(series_columns(())) == 0
    assert make_trials({"mse": {"A": [1.0]}}).series.columns.tolist() == names
