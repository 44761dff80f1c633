"""souto2011 at full size: moments against runs, and what is published."""

import numpy as np
import pytest
from data_frames import comparison_frame

from rmpc_bench.analysis.comparison import levels

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("point", range(3))
@pytest.mark.parametrize("method", ["ERP", "classic"])
def test_exact_moments_and_500_runs_agree(trials_of, point, method):
    """Either checks the other: means within 6 standard errors, variances within 6 of theirs, at every k of Fig. 4.

    6 and not 5, because the largest of 1500 steps x 2 states is looked at; the error's tails are heavier than normal
    ones, so its variance is given 1.5 times the standard error sqrt(2 / n) of normal errors.
    """
    _, trials = trials_of("souto2011/fig4")
    table = trials.points[point]
    rows = table.series[table.series["method"] == method]
    exact, sampled = (rows[rows["n"] == n].set_index(["quantity", "component", "k"])["value"] for n in (0, 500))
    for i in ("0", "1"):
        mean, var = exact["mean(e)"][i], exact["cov(e)"][f"{i},{i}"]
        assert (np.abs(sampled["mean(e)"][i] - mean) <= 6 * np.sqrt(var / 500)).all()
        assert (np.abs(sampled["cov(e)"][f"{i},{i}"] / var - 1) <= 6 * 1.5 * np.sqrt(2 / 500)).all()


def test_the_covariances_that_the_chapter_prints(trials_of):
    """Oracle: Section 5, to its digits."""
    _, trials = trials_of("souto2011/table")
    np.testing.assert_allclose(trials.matrix_series("P", "ERP")[1500], [[14.4, -22.7], [-22.7, 76.4]], atol=0.05)
    np.testing.assert_allclose(trials.matrix_series("P", "classic")[1500], [[3.6, -0.6], [-0.6, 0.1]], atol=0.05)


@pytest.mark.parametrize(
    ("point", "method", "mean_square"),
    [(0, "ERP", 16.78), (0, "classic", 465.5), (1, "ERP", 21.32), (1, "classic", 2311.7)],
)
def test_mean_squares_of_both_predictors(trials_of, point, method, mean_square):
    """Oracle: the independent study, exact at k = 300, with delta on [-1, 1] and on the unit interval."""
    table = trials_of("souto2011/comparison")[1].points[point]
    mean = table.matrix_series("mean(e)", method)[300]
    found = np.trace(table.matrix_series("cov(e)", method)[300]) + mean @ mean
    # Half a unit of the last digit of the study.
    assert found == pytest.approx(mean_square, rel=0, abs=0.05 if mean_square > 100 else 0.005)


def test_one_noise_has_the_bound_of_two_once_it_is_tuned(trials_of):
    """Oracle: the study's 58.23 for two noises; the larger set of F of one noise cannot have a much smaller bound."""
    _, trials = trials_of("souto2011/alpha")
    two, one = (np.trace(trials.matrix_series("P", method)[300]) for method in ("tuned", "one noise"))
    assert two == pytest.approx(58.23, abs=0.1)
    # Minimising each step alone leaves 0.1 % between them.
    assert one == pytest.approx(two, rel=2e-3)


def test_averages_contradict_each_other_for_a_frozen_uncertainty(trials_of):
    """The classic predictor is better in most runs, and worse in the mean, which few runs with a large error decide."""
    _, trials = trials_of("souto2011/comparison")
    (table,) = [point for point in trials.points if point.point["name"] == "frozen"]
    rows = comparison_frame(table, levels(trials)).query("metric == 'estimation_mse'").set_index("method")
    row = rows.loc["classic-RV"]
    assert row["geometric_high"] < 0 < row["mean_low"] and row["verdict"] == "depends-on-average"
    log_ratio = np.log(table.column("estimation_mse", "classic-RV") / table.column("estimation_mse", "ERP"))
    assert row["geometric_pct"] == pytest.approx(100 * np.expm1(log_ratio.mean()), rel=1e-9)
