"""Coverage of adjusted intervals in few samples; docs/numbers.md has that of many, see tests/coverage_study.py."""

import math
from pathlib import Path

import numpy as np
import pytest
from adjusted_study import POPULATIONS, coverage, samples
from scipy import stats

from rmpc_bench.analysis.intervals import mean_interval

SETS = 60
"""Samples of a population; a coverage of 0.95 has a standard error of 0.028."""


@pytest.mark.parametrize("name", POPULATIONS)
def test_adjusted_intervals_cover_as_plain_ones(name):
    """Not less than the plain one by more than 0.02 and three errors of the difference, which are paired."""
    found = coverage(samples(name, 120, SETS), 0.0, "A")
    assert found.adjusted >= 0.95 - 3 * math.sqrt(0.95 * 0.05 / SETS) - 0.02
    assert found.adjusted >= found.plain - 0.02 - 3 * math.sqrt(0.03 / SETS)
    # Ten pairs per term: the loss where the draws explain nothing.
    assert found.ratio > 0.85
    assert found.wrong <= 1 - found.adjusted + 1e-9 or name.startswith("ties")


ROOT = Path(__file__).parents[2]
SECTION = (ROOT / "docs/numbers.md").read_text(encoding="utf-8").partition("## Adjusted comparisons\n")[2]


def table(head):
    """Return the rows of a table of the section, without its two lines of the head."""
    lines = SECTION.partition(f"| {head} |")[2].partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_the_table_of_many_samples():
    """Oracle: the level, and what the page says of the smallest share and of the plain intervals."""
    rows = [[name, int(n), *map(float, cells)] for name, n, _, *cells in table("Population")]
    assert {row[0] for row in rows} >= {*POPULATIONS} and min(row[2] for row in rows) >= 0.94
    assert all(adjusted >= min(plain, 0.95) - 0.02 for _, _, adjusted, plain, _ in rows)
    assert [(name, n) for name, n, adjusted, plain, _ in rows if round(plain - adjusted, 3) > 0.02] == [("jump", 120)]


@pytest.mark.parametrize(("n", "exact"), [(60, 0.979), (120, 0.982), (300, 0.963)])
def test_the_plain_interval_of_the_jump_is_too_wide(n, exact):
    """Oracle: the difference is 1 in one eighth of the runs, so that the binomial law gives the coverage exactly."""
    found = 0.0
    for k in range(1, n):
        if (share := stats.binom.pmf(k, n, 1 / 8)) > 1e-9:
            low, high = mean_interval(np.repeat([7 / 8, -1 / 8], [k, n - k]), 0.95, 7)
            found += share * (low <= 0 <= high)
    assert found == pytest.approx(exact, abs=6e-4)
    row = next(row for row in table("Population") if row[:2] == ["jump", str(n)])
    assert float(row[4]) == pytest.approx(exact, abs=3 * math.sqrt(exact * (1 - exact) / 2000))
