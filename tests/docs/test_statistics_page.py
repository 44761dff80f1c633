"""The page docs/statistics.md: worked comparisons are what the program computes, and cover every verdict."""

import re

import numpy as np
import pandas as pd
import pytest
from docs.markdown import ROOT
from docs.worked_comparisons import CASES, PAGE, SHOWN, row_of_comparison, screen_of, smoke, table_of

from rmpc_bench.analysis.shown_numbers import plain
from rmpc_bench.analysis.verdict import Verdict

MADE = {make.__name__: table_of(make()) for make in CASES}
OTHERS = """
better: -9.5 % [-11.6, -7.3] | -9.3 % [-11.5, -7.2] | 30/0/10 | 88 % [80, 93] | better
worse: x1.0e62 [1.3e60, 7.7e63] | x4.3e73 [2.0e68, 9.5e78] | 0/40/0 | 0 % [0, 9] | worse
better_size_uncertain: -5 % [-9, -1] | -3 % [-7, +2] | 58/39/4 | 59 % [49, 69] | better, perhaps by less than 1 %
worse_size_uncertain: +4.5 % [+0.9, +8.2] | -1 % [-5, +3] | 37/58/6 | 40 % [31, 49] | worse, perhaps by less than 1 %
equivalent: 0.00 % [0.00, 0.00] | 0.00 % [0.00, 0.00] | 0/0/60 | 50 % [47, 53] | equivalent
inconclusive: -3.9 % [-7.6, 0.0] | -2.0 % [-5.8, +2.1] | 56/41/4 | 57 % [47, 67] | inconclusive
few_runs: -5.8 % [-7.0, -4.5] | -5.8 % [-7.0, -4.5] | 8/0/0 | 100 % [63, 100] | better
"""
"""Cases that are not on the page: both averages, won/lost/tied, superiority, verdict."""


def compared(name):
    """Return the row of comparisons.csv of a case."""
    return MADE[name].rows[1].compared


def test_every_verdict_occurs():
    assert len(CASES) == 10
    assert {compared(name)["verdict"] for name in MADE} == {str(word) for word in Verdict}


def test_the_other_comparisons():
    """Quiet changes of an interval or a verdict would appear here, or on the page."""
    rows = {name: [*row_of_comparison(table).values()][2:] for name, table in MADE.items()}
    made = [f"{name}: {plain(' | '.join(row))}" for name, row in rows.items()]
    assert [line for make, line in zip(CASES, made, strict=True) if make not in SHOWN] == OTHERS.strip().splitlines()


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("better_size_uncertain", -9.0, -0.8),
        ("worse_size_uncertain", 0.9, 8.2),
        ("inconclusive", -7.6, 0.04),
        ("depends_on_average", 16.0, 25.0),
    ],
)
def test_the_runs_have_the_intervals_that_they_are_constructed_for(name, low, high):
    row = compared(name)
    np.testing.assert_allclose([row["geometric_low"], row["geometric_high"]], [low, high], rtol=1e-6)


def test_a_smoke_run_has_no_numbers_but_its_sizes():
    assert screen_of(smoke()).split() == ["A", "ran", "B", "ran"]


def test_the_table_of_calibration():
    """Oracle: the kept results of the example."""
    kept = pd.read_csv(ROOT / "results" / "examples" / "calibration" / "summary.csv").set_index(["method", "metric"])
    rows = re.findall(r"^\| (\w+) \| ([\d.]+) % \[.*?\| (0\.\d+) \| ([\d.]+) \|", PAGE.read_text("utf-8"), re.MULTILINE)
    assert len(rows) == 4
    for name, at_90, at_50, at_95 in rows:
        shares = [kept.loc[(name, f"coverage_{level}"), "mean"] for level in (50, 90, 95)]
        assert (float(at_50), float(at_95)) == (round(shares[0], 2), round(shares[2], 2)), name
        assert float(at_90) == pytest.approx(100 * shares[1], abs=0.05), name
