"""CSV files have the bytes of pandas, and those for version control the same bytes where numbers differ by rounding."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from data_frames import arrays

from rmpc_bench.analysis.columns import columns_of
from rmpc_bench.analysis.comparison import COLUMNS, comparisons
from rmpc_bench.analysis.statistics import SUMMARY, summary
from rmpc_bench.report import point_tables
from rmpc_bench.report.point_tables import comparisons_table, csv_lines, summary_table, trials_csv, write_csv
from rmpc_bench.types import MetricInfo

RNG = np.random.default_rng(2)
FRAMES = {
    "floats": pd.DataFrame({"a": [0.1, 1e300, 1e-5, -0.0], "b": [np.nan, np.inf, -np.inf, 1e16]}),
    "random": pd.DataFrame(RNG.lognormal(0, 50, (300, 3)), columns=list("abc")),
    "kinds": pd.DataFrame(
        {"run": [1, 2, 3], "small": np.array([1.5, np.nan, 0.1], dtype=np.float32), "ok": [True, False, True]}
    ),
    "texts": pd.DataFrame({"name": ["a,b", 'c"d', "e\nf", "é, ä", "", None, " x "], "n": range(7)}),
    "mixed": pd.DataFrame({"a": [1, 2.5, "x", None, np.nan, "1,5", True], "b": [1] * 7}, dtype=object),
    "nullable": pd.DataFrame({"n": pd.Series([1, None, 3], dtype=object), "b": [1.0, 2.0, np.nan]}),
    "empty": pd.DataFrame({"a": [], "b": []}),
    "one column": pd.DataFrame({"a": [1.0, np.nan]}),
    "names": pd.DataFrame([[1, 2]], columns=["controller.Hp, Hu", 'a"b']),
    "nothing": pd.DataFrame(),
}


@pytest.mark.parametrize("name", FRAMES)
def test_bytes_of_pandas(name, tmp_path, monkeypatch):
    """Oracle: `DataFrame.to_csv`, also where blocks of rows end."""
    frame = FRAMES[name]
    for rows in (2, 20_000):
        monkeypatch.setattr(point_tables, "ROWS", rows)
        write_csv(arrays(frame), tmp_path / "a.csv")
        expected = frame.to_csv(index=False, lineterminator="\n").encode()
        assert (tmp_path / "a.csv").read_bytes() == expected


def test_columns(make_trials, tmp_path):
    """In order; missing is empty, infinite is inf; the derived tables have no index."""
    trials = make_trials({"mse": {"A": [0.1, "diverged"], "B": [math.inf, 1e-7]}})
    trials = replace(trials, columns={"extra": np.ones(4, dtype=int), **trials.columns})
    trials_csv(trials, tmp_path / "trials.csv")
    expected = b"method,run,status,mse\nA,0,ok,0.1\nA,1,diverged,\nB,0,ok,inf\nB,1,ok,1e-07\n"
    assert (tmp_path / "trials.csv").read_bytes() == expected
    trials = make_trials({"mse": {"A": [1.0, 2.0], "B": [2.0, "diverged"]}})
    write_csv(columns_of(summary(trials), SUMMARY), tmp_path / "summary.csv")
    write_csv(columns_of(comparisons(trials), COLUMNS), tmp_path / "comparisons.csv")
    lines = (tmp_path / "summary.csv").read_text().splitlines()
    assert lines[0].startswith("method,metric,n,n_failed,mean,se,") and lines[2].startswith("B,mse,1,1,2.0,,,,2.0,")
    text = (tmp_path / "comparisons.csv").read_text().splitlines()[1]
    assert text.startswith("B,A,mse,100.0,,,0,2,0,0.0,1.000,1,inconclusive,geometric,")


def test_floats_are_in_their_shortest_form_and_carriage_returns_in_quotes(tmp_path):
    """float() gives them back bit for bit; readers take a carriage return for the end of a line."""
    value = np.random.default_rng(0).integers(0, 2**64, 5000, dtype=np.uint64).view(np.float64)
    value[7] = 5e-324
    write_csv({"component": ["0,1"] * 5000, "k": np.arange(5000), "value": value}, tmp_path / "series.csv")
    lines = (tmp_path / "series.csv").read_bytes().decode().split("\n")
    texts = ["" if math.isnan(number) else repr(number) for number in value.tolist()]
    assert lines == ["component,k,value", *(f'"0,1",{k},{text}' for k, text in enumerate(texts)), ""]
    frame = pd.DataFrame({"name": ["g\rh", "i"], "n": [1, 2]})
    write_csv(arrays(frame), tmp_path / "a.csv")
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "a.csv"), frame, check_dtype=False)


METRICS = [MetricInfo("mse", "rad^2", "lower"), MetricInfo("offset", "rad", "zero")]


def with_noise(trials, rng):
    """Change every value in its last digits, and a zero by what is left of a difference of such numbers."""
    columns = dict(trials.columns)
    for info in trials.metrics:
        values = columns[info.name]
        relative, left = rng.uniform(-1e-14, 1e-14, len(values)), rng.uniform(0, 1e-15, len(values))
        columns[info.name] = np.where(values == 0, left, values * (1 + relative))
    return replace(trials, columns=columns)


def described(trials):
    return summary_table(columns_of(summary(trials), SUMMARY))


def compared(trials):
    return comparisons_table(columns_of(comparisons(trials), COLUMNS))


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
    made = [trials, *(with_noise(trials, rng) for _ in range(5))]
    found = {"".join([*csv_lines(described(t)), *csv_lines(compared(t))]) for t in made}
    assert len(found) == 1


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        # 1/3 and 2/3 in the mean and its error; n stays a whole number.
        ([0.0, 0.0, 1.0], [1.0] * 3, {"n": 3, "n_failed": 0, "mean": 0.333333, "se": 0.333333, "max": 1.0}),
        # A number beside a large one is zero; the largest run of all does not count.
        ([1e-16, 2e-16, 1e-16, 3e-16, 1e-16], [0.1, 0.2, 0.2, 0.3, 1e12], {"mean": 0.0, "max": 0.0}),
        ([0.1, 0.2, 0.2, 0.3, 1e12], [1e-16, 2e-16, 1e-16, 3e-16, 1e-16], {"median": 0.2, "max": 1e12}),
        # 2e-9 to 5e-9 of the other keep their spread: deviations -0.2, 0, 0.1, 0.1 give sqrt(0.06 / 3 / 4).
        ([0.2, 0.4, 0.5, 0.5], [1e8] * 4, {"mean": 0.4, "se": 0.0707, "min": 0.2, "max": 0.5}),
    ],
)
def test_digits_by_hand(make_trials, a, b, expected):
    table = described(make_trials({"mse": {"A": a, "B": b}}, METRICS[:1]))
    assert {name: table[name][0] for name in expected} == expected and "did_not_occur" not in table


def test_equal_methods_are_not_separated(make_trials):
    """Rounding errors of one sign in all runs have an interval that leaves out 0, and are no difference."""
    values = [0.1, 0.2, 0.3, 0.4]
    trials = make_trials({"mse": {"A": values, "B": [value * (1 - 4e-16) for value in values]}}, METRICS[:1])
    row = {name: cells[0] for name, cells in compared(trials).items()}
    assert (row["change_pct"], row["superiority"], row["p_wilcoxon_holm"]) == (0.0, 0.5, "1.000")
    assert row["verdict"] == "inconclusive"
