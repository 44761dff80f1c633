"""Rounding and missing measurements: grids by hand, shares and gaps of the chain."""

import numpy as np
import pytest
from conftest import ROUND, within_stat

from rmpc_bench.noise.measurement import missing, quantised
from rmpc_bench.types import DesignError


def fresh(seed=1):
    """Generator of a run."""
    return np.random.default_rng(seed)


def gaps(lost):
    """Lengths of the gaps between the first and the last sample that is there."""
    ends = np.flatnonzero(~lost)
    lengths = np.diff(ends) - 1
    return lengths[lengths > 0]


def test_rounding_by_hand():
    """Oracle: numbers by hand, ties to the even multiple; what is missing stays missing."""
    law = quantised(2, step=[0.5, 10.0], offset=[0.0, 5.0])
    y = np.array([[0.24, 9.9], [0.26, 10.1], [-0.74, -4.9], [0.25, 0.0], [0.75, 20.0], [np.nan, 5.0]])
    expected = [[0.0, 5.0], [0.5, 15.0], [-0.5, -5.0], [0.0, 5.0], [1.0, 25.0], [np.nan, 5.0]]
    np.testing.assert_array_equal(law.altered(y, law.draw(fresh(), 6)), expected)


def test_with_only_a_list_has_one_number_per_name():
    """Oracle: the law of all outputs, by hand; the order is that of `only`."""
    law = quantised(3, signal_names=["a", "b", "c"], step=[2.0, 0.5], offset=[1.0, 0.25], only=["c", 0])
    y = np.array([[0.6, 0.123, 4.2]])
    np.testing.assert_array_equal(law.altered(y, law.draw(fresh(), 1)), [[0.75, 0.123, 5.0]])


def test_the_error_of_rounding_is_uniform_for_a_small_step():
    """Oracle: step^2 / 12 for a signal that is spread over many steps."""
    law, y = quantised(1, step=0.1), 3.0 * fresh().standard_normal((40_000, 1))
    error = law.altered(y, law.draw(fresh(), len(y))) - y
    assert (np.abs(error) <= 0.05 + 1e-12).all()  # half a step and a rounding
    assert within_stat(error, 0.0) and within_stat(error**2, 0.01 / 12)


@pytest.mark.parametrize("outputs", ["together", "each"])
@pytest.mark.parametrize("gap", [None, 1.0, 2.5])
def test_share_and_gaps_of_missing_measurements(outputs, gap):
    """Oracle: the probability, over runs at any k; the mean length of a gap, 1 / (1 - p) without the key."""
    law, p = missing(2, probability=0.3, gap=gap, outputs=outputs), 0.3
    short = np.array([law.draw(np.random.default_rng((3, run)), 6) for run in range(3000)])
    assert within_stat(short, p)
    lost = law.draw(fresh(), 40_000) > 0.0
    assert (lost[:, 0] == lost[:, 1]).all() == (outputs == "together")
    if outputs == "each":
        assert within_stat(short.all(axis=2), p**2)
    assert within_stat(gaps(lost[:, 0]), 1.0 / (1.0 - p) if gap is None else gap)
    y = fresh().standard_normal(lost.shape)
    found = law.altered(y, lost.astype(float))
    np.testing.assert_array_equal(found, np.where(lost, np.nan, y))


def test_limits_of_the_probability():
    """Oracle: none, all; a smaller probability omits a part of what a larger one omits; the chain has the limit."""
    assert not missing(1, probability=0.0).draw(fresh(), 100).any()
    assert missing(2, probability=1.0).draw(fresh(), 100).all()
    few, many = (missing(1, probability=p).draw(fresh(), 500) for p in (0.2, 0.5))
    assert (few <= many).all() and (few != many).any()
    chain = missing(1, probability=0.2, gap=1.0 / 0.8)
    np.testing.assert_allclose([chain.enters, chain.stays], 0.2, **ROUND)


@pytest.mark.parametrize(("p", "gap"), [(0.9, 9.0), (0.7, 7.0 / 3.0), (2.0 / 3.0, 2.0)])
def test_gaps_with_one_sample_between_them(p, gap):
    """Oracle: at p = gap / (gap + 1) one sample is between two gaps, whichever way p / (1 - p) is rounded."""
    law = missing(1, probability=p, gap=gap)
    lost = law.draw(fresh(), 40_000)[:, 0] > 0.0
    assert (lost[1:] | lost[:-1]).all()
    assert within_stat(gaps(lost), gap)


@pytest.mark.parametrize(("p", "gap"), [(0.9, 2.0), (1.0, 5.0)])
def test_a_chain_that_does_not_exist_is_a_design_error(p, gap):
    """Oracle: two gaps have at least one sample between them, so that p <= gap / (gap + 1)."""
    with pytest.raises(DesignError, match="mean gap is") as caught:
        missing(1, probability=p, gap=gap)
    assert caught.value.parameter == "gap"


def test_sizes_that_do_not_fit_are_design_errors():
    """Oracle: the docstring."""
    with pytest.raises(DesignError, match="2 numbers") as caught:
        quantised(2, step=[1.0, 2.0, 3.0])
    assert caught.value.parameter == "step"
