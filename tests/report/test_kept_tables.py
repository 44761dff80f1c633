"""summary.csv and comparisons.csv: the same bytes where numbers differ by rounding errors."""

from dataclasses import replace

import numpy as np
import pytest

from rmpc_bench.analysis.comparison import comparisons
from rmpc_bench.analysis.statistics import summary
from rmpc_bench.report.csv_file import comparisons_table, summary_table
from rmpc_bench.types import MetricInfo

METRICS = [MetricInfo("mse", "rad^2", "lower"), MetricInfo("offset", "rad", "zero")]


def with_noise(trials, rng):
    """Change every value in its last digits, and a zero by what is left of a difference of such numbers."""
    frame = trials.frame.copy()
    for info in trials.metrics:
        values = frame[info.name].to_numpy(dtype=float)
        relative, left = rng.uniform(-1e-14, 1e-14, len(values)), rng.uniform(0, 1e-15, len(values))
        frame[info.name] = np.where(values == 0, left, values * (1 + relative))
    return replace(trials, frame=frame)


@pytest.fixture
def trials(make_trials, rng):
    """Return methods that are equal, nearly equal, better in some runs by nothing, and one without a spread."""
    first = rng.uniform(0.5, 2.0, 12).round(2)
    nearly, second = first * (1 + 1e-7 * rng.standard_normal(12)), first.copy()
    second[:3] *= 0.8
    values = {"A": first, "B": nearly, "C": second, "D": np.full(12, 0.3), "E": first}
    small = {"A": first - 1.0, "B": nearly - first, "C": np.full(12, 0.05), "D": np.full(12, 0.1), "E": first - 1.0}
    return make_trials(
        {name: {m: [*v] for m, v in data.items()} for name, data in (("mse", values), ("offset", small))}, METRICS
    )


def test_rounding_errors_change_no_byte(trials, rng):
    """Numbers, counts, ranks and words, where the runs of two methods differ by rounding errors only, too."""
    expected = [table.to_csv() for table in (summary_table(summary(trials)), comparisons_table(comparisons(trials)))]
    for _ in range(5):
        other = with_noise(trials, rng)
        found = [table.to_csv() for table in (summary_table(summary(other)), comparisons_table(comparisons(other)))]
        assert found == expected


def test_six_digits_and_exact_counts(make_trials):
    """By hand: 1/3 and 2/3 in the mean and its error; n stays a whole number."""
    trials = make_trials({"mse": {"A": [0.0, 0.0, 1.0], "B": [1.0, 1.0, 1.0]}}, METRICS[:1])
    row = summary_table(summary(trials)).to_dict("records")[0]
    assert (row["n"], row["n_failed"], row["mean"], row["se"], row["max"]) == (3, 0, 0.333333, 0.333333, 1.0)
    assert "did_not_occur" not in row


def test_a_number_beside_a_large_one_is_zero(make_trials):
    """A method whose metric is 1e-16 where that of another is 0.1; the largest run of all does not count."""
    values = {"A": [1e-16, 2e-16, 1e-16, 3e-16, 1e-16], "B": [0.1, 0.2, 0.2, 0.3, 1e12]}
    rows = summary_table(summary(make_trials({"mse": values}, METRICS[:1]))).to_dict("records")
    assert (rows[0]["mean"], rows[0]["max"]) == (0.0, 0.0)
    assert (rows[1]["median"], rows[1]["max"]) == (0.2, 1e12)


def test_a_row_beside_a_large_one_keeps_its_spread(make_trials):
    """A method whose metric is 2e-9 to 5e-9 of that of another: its smallest run and the error of its mean, not 0."""
    values = {"A": [0.2, 0.4, 0.5, 0.5], "B": [1e8, 1e8, 1e8, 1e8]}
    row = summary_table(summary(make_trials({"mse": values}, METRICS[:1]))).to_dict("records")[0]
    # By hand: the deviations -0.2, 0, 0.1, 0.1 give sqrt(0.06 / 3 / 4).
    assert (row["mean"], row["se"], row["min"], row["max"]) == (0.4, 0.0707, 0.2, 0.5)


def test_equal_methods_are_not_separated(make_trials):
    """Rounding errors of one sign in all runs have an interval that leaves out 0, and are no difference."""
    values = [0.1, 0.2, 0.3, 0.4]
    trials = make_trials({"mse": {"A": values, "B": [value * (1 - 4e-16) for value in values]}}, METRICS[:1])
    row = comparisons_table(comparisons(trials)).to_dict("records")[0]
    assert (row["change_pct"], row["superiority"], row["p_wilcoxon_holm"]) == (0.0, 0.5, "1.000")
    assert row["verdict"] == "inconclusive"
