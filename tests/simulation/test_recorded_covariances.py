"""Covariances and sets that the record keeps of an estimator, and its controller."""

import numpy as np
import pytest
from simulation.test_closed_loop import RUNS, STEPS, toy_draws
from simulation.toy import Halfway, Proportional, Walk

from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.types import Method


class Reporting(Halfway):
    """The toy's estimator, with a P and an M that grow with k; M per run, or not at all samples, if wanted."""

    def __init__(self, *, per_run=False, until=STEPS):
        self.per_run, self.until = per_run, until

    def matrix(self, k, n_runs):
        """Return M at k."""
        runs = np.arange(1.0, n_runs + 1.0).reshape(-1, 1, 1)
        return (10.0 + k) * runs if self.per_run else np.array([[10.0 + k]])

    def correct(self, k, state, y):
        """Meet halfway and report P and M."""
        state, estimate = super().correct(k, state, y)
        M = self.matrix(k, len(y)) if k <= self.until else None
        return state, estimate._replace(P=np.array([[1.0 + k]]), M=M)


def recorded(rng, estimator, **kept):
    """Simulate five runs of the toy plant and return the record and the controller."""
    controller, r = Proportional(), np.zeros((STEPS + 2, 1))
    draws = toy_draws(rng, [0.9] * RUNS)
    return simulate(Walk(), Method("M", estimator, controller), draws, r, STEPS, **kept)[0], controller


@pytest.mark.parametrize("per_run", [False, True])
def test_covariances_and_sets_are_kept_over_k(per_run, rng):
    """Oracle: 1 + k and 10 + k, times the number of the run where every run has its own."""
    record, controller = recorded(rng, Reporting(per_run=per_run), with_P=True, with_M=True)
    k = np.arange(STEPS + 1.0)
    np.testing.assert_array_equal(record.P[:, 0, 0], 1.0 + k)
    M = np.outer(np.arange(1.0, RUNS + 1.0), 10.0 + k) if per_run else 10.0 + k
    np.testing.assert_array_equal(record.M[..., 0, 0], M)
    assert record.M.flags.c_contiguous and record.controller is controller


@pytest.mark.parametrize(("kept", "names"), [({}, ()), ({"with_P": True}, ("P",)), ({"with_M": True}, ("M",))])
def test_only_what_is_asked_for_is_kept(kept, names, rng):
    """Oracle: the keywords; trajectories do not depend on them."""
    record, controller = recorded(rng, Reporting(), **kept)
    assert tuple(name for name in ("P", "M") if getattr(record, name) is not None) == names
    assert record.controller is controller
    everything, _ = recorded(np.random.default_rng(20180418), Reporting(), with_P=True, with_M=True)
    for ours, theirs in zip(record[1:5], everything[1:5], strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_set_that_is_missing_at_some_k_is_not_kept(rng):
    """Oracle: M is missing at the last sample; P is."""
    record, _ = recorded(rng, Reporting(until=STEPS - 1), with_P=True, with_M=True)
    assert record.M is None and record.P is not None
    record, _ = recorded(rng, Halfway(), with_P=True, with_M=True)
    assert record.M is None and record.P is None
