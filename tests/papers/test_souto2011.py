"""souto2011 at full size: moments against runs, and what is published."""

import numpy as np
import pytest

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
