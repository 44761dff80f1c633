"""souto2011 and the benchmark systems at full size: every recorded finding is found again, and what is published."""

from pathlib import Path

import numpy as np
import pytest

from rmpc_bench.analysis.claims import judge

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2] / "configs"
CONFIGS = [
    f"{path.parent.name}/{path.stem}"
    for paper in ("souto2011", "benchmarks")
    for path in sorted((ROOT / paper).iterdir())
]


@pytest.mark.parametrize("name", CONFIGS)
def test_every_finding_is_the_recorded_one(trials_of, name):
    """What the configuration records is what its trials and moments say."""
    config, trials = trials_of(name)
    found = {claim.says: (judge(claim, trials).finding, claim.finding) for claim in config.claims}
    assert {says: now for says, (now, _) in found.items()} == {says: recorded for says, (_, recorded) in found.items()}
    assert (trials.frame["status"] == "ok").all()


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
