"""Coverage of adjusted intervals in few samples; tests/coverage_study.py prints the table of many."""

import math

import pytest
from adjusted_study import POPULATIONS, coverage, samples

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
