"""The verdict as a function of intervals, counts and failed runs."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rmpc_bench.analysis.intervals import FEW, NONE
from rmpc_bench.analysis.verdict import Evidence, Failures, Verdict, verdict

ends = st.floats(-0.2, 0.2)
intervals = st.tuples(ends, ends).map(lambda pair: (min(pair), max(pair)))
margins = st.floats(0.0, 0.1)
EXCHANGED = {
    Verdict.BETTER: Verdict.WORSE,
    Verdict.WORSE: Verdict.BETTER,
    Verdict.BETTER_SIZE_UNCERTAIN: Verdict.WORSE_SIZE_UNCERTAIN,
    Verdict.WORSE_SIZE_UNCERTAIN: Verdict.BETTER_SIZE_UNCERTAIN,
}
STRENGTH = [Verdict.EQUIVALENT, Verdict.BETTER_SIZE_UNCERTAIN, Verdict.BETTER]
"""Of an interval below 0, as the margin shrinks."""
MIRRORED = {Verdict.WORSE: Verdict.BETTER, Verdict.WORSE_SIZE_UNCERTAIN: Verdict.BETTER_SIZE_UNCERTAIN}


def evidence(interval, margin=0.01, **changes):
    """Return evidence from 200 pairs, all untied."""
    return Evidence(interval, margin, **{"n_pairs": 200, "n_untied": 200, "superiority": (0.4, 0.6), **changes})


@given(intervals, margins)
def test_exactly_one_verdict(interval, margin):
    """The cases of the table, written out one by one, exclude each other."""
    low, high = interval
    inside = -margin <= low and high <= margin
    cases = {
        Verdict.EQUIVALENT: inside,
        Verdict.BETTER: high < -margin,
        Verdict.WORSE: low > margin,
        Verdict.BETTER_SIZE_UNCERTAIN: -margin <= high < 0 and not inside,
        Verdict.WORSE_SIZE_UNCERTAIN: 0 < low <= margin and not inside,
        Verdict.INCONCLUSIVE: low <= 0 <= high and not inside,
    }
    assert [word for word, holds in cases.items() if holds] == [verdict(evidence(interval, margin))]


@given(intervals, margins, margins)
def test_monotone_in_the_margin(interval, one, other):
    """A larger margin never makes a difference more relevant, and equivalence stays."""
    small, large = sorted((one, other))
    first, second = (verdict(evidence(interval, margin)) for margin in (small, large))
    if first in (Verdict.EQUIVALENT, Verdict.INCONCLUSIVE):
        assert second in (first, Verdict.EQUIVALENT)
    else:
        ranks = [STRENGTH.index(MIRRORED.get(word, word)) for word in (first, second)]
        assert ranks[0] >= ranks[1]
        assert second == Verdict.EQUIVALENT or (first in MIRRORED) == (second in MIRRORED)


@given(intervals, margins, intervals, st.integers(0, 2 * FEW), intervals)
def test_exchanged_methods_exchange_the_words(interval, margin, other, n_untied, superiority):
    """On logs all intervals change their sign; the probability of superiority its distance from 1/2."""

    def turned(pair):
        return -pair[1], -pair[0]

    def share(pair):
        return tuple(0.5 + end for end in pair)

    found = verdict(evidence(interval, margin, other=other, n_untied=n_untied, superiority=share(superiority)))
    swapped = evidence(
        turned(interval), margin, other=turned(other), n_untied=n_untied, superiority=share(turned(superiority))
    )
    assert verdict(swapped) == EXCHANGED.get(found, found)


@pytest.mark.parametrize(
    ("interval", "other", "word"),
    [
        ((-0.2, -0.1), (0.05, 0.1), "depends-on-average"),
        ((0.002, 0.1), (-0.1, -0.001), "depends-on-average"),
        ((-0.2, -0.1), (-0.01, 0.1), "better"),
        ((-0.2, -0.1), NONE, "better"),
        ((-0.1, 0.1), (0.05, 0.1), "inconclusive"),
    ],
)
def test_two_averages(interval, other, word):
    """Both intervals must exclude 0, with opposite signs."""
    assert verdict(evidence(interval, other=other)) == word


@pytest.mark.parametrize(
    ("interval", "n_untied", "superiority", "word"),
    [
        (NONE, 200, (0.51, 0.7), "better"),
        (NONE, 200, (0.2, 0.49), "worse"),
        (NONE, 200, (0.5, 0.7), "inconclusive"),
        ((-0.3, -0.2), FEW - 1, (0.4, 0.7), "inconclusive"),
        ((-0.3, -0.2), FEW, (0.4, 0.7), "better"),
        ((-0.001, 0.001), 0, (0.49, 0.51), "equivalent"),
    ],
)
def test_counts(interval, n_untied, superiority, word):
    """They decide without an interval or with few untied pairs."""
    assert verdict(evidence(interval, n_untied=n_untied, superiority=superiority)) == word


def test_few_pairs_are_not_equivalent():
    """Ten equal runs show little of a plant."""
    assert verdict(evidence((0.0, 0.0), n_pairs=FEW - 1, n_untied=0)) == "inconclusive"
    assert verdict(evidence((0.0, 0.0), margin=0.0, n_pairs=FEW, n_untied=0)) == "equivalent"


BETTER, WORSE, EQUAL = (evidence(interval) for interval in ((-0.3, -0.2), (0.2, 0.3), (-0.001, 0.001)))


@pytest.mark.parametrize(
    ("seen", "failures", "word"),
    [
        (BETTER, Failures(10, 0, (0.02, 0.05), BETTER), "fails-more"),
        (BETTER, Failures(1, 0, (-0.02, 0.005), BETTER), "better"),
        (BETTER, Failures(1, 0, (-0.02, 0.005), EQUAL), "inconclusive"),
        (EQUAL, Failures(2, 1, (-0.02, 0.03), evidence((-0.1, 0.1))), "inconclusive"),
        (WORSE, Failures(2, 1, (-0.02, 0.03), evidence((-0.1, 0.9))), "worse"),
        (BETTER, Failures(3, 3, (-0.02, 0.02), EQUAL), "better"),
        (WORSE, Failures(0, 10, (-0.05, -0.02), BETTER), "inconclusive"),
        (WORSE, Failures(0, 1, (-0.02, 0.01), WORSE), "worse"),
        (BETTER, Failures(0, 10, (-0.05, -0.02), BETTER), "better"),
    ],
)
def test_failed_runs(seen, failures, word):
    """A failure more may be chance: it takes away a word, and does not prove another one."""
    assert verdict(seen, failures) == word


def test_nan_decides_nothing():
    """Without interval and without runs."""
    assert verdict(Evidence(NONE, 0.01, 0, 0)) == "inconclusive"
    assert math.isnan(NONE[0])
