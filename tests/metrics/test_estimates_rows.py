"""Metrics of states, estimates and samples: the values of a run have the same bits alone and in a block."""

import pickle

import numpy as np
import pytest
from metrics.estimate_records import trajectories

from rmpc_bench.metrics.consistency import Nees
from rmpc_bench.metrics.cost import Cost
from rmpc_bench.metrics.estimation import EstimationMse
from rmpc_bench.metrics.sample import Sample
from rmpc_bench.metrics.sets import Inside
from rmpc_bench.metrics.tracking import Mae, Mse, Rmse
from rmpc_bench.types import Record

METRICS = [
    *(kind(of=of) for kind in (Mse, Rmse, Mae) for of in ("state", "estimate")),
    EstimationMse(),
    Nees(),
    *(Inside(of=of) for of in (None, "set", "gaussian", "sum")),
    Cost(Q_x=[3.0, 0.1, 1.0], R_u=0.7),
    *(Sample(of=of) for of in ("x.1", "e.2", "y.1", "u.0")),
]


def row(block, i):
    """Run i as a batch of one, in memory of its own."""
    matrices = (each if each.ndim == 3 else each[i : i + 1].copy() for each in (block.P, block.M))
    signals = (each[i : i + 1].copy() for each in block[1:5])
    return Record(block.Ts, *signals, block.r, *matrices, experiment=block.experiment)


@pytest.mark.parametrize("metric", METRICS, ids=repr)
@pytest.mark.parametrize("per_run", [False, True])
@pytest.mark.parametrize("n_steps", [1, 130])
def test_a_row_has_the_bits_it_has_alone(metric, per_run, n_steps, rng):
    """Oracle: a batch of one; 130 samples of 3 states make NumPy's sums pairwise."""
    block = trajectories(rng, 11, n_steps, per_run=per_run)
    metric = pickle.loads(pickle.dumps(metric))
    values = metric.evaluate(block)
    for i in range(11):
        np.testing.assert_array_equal(metric.evaluate(row(block, i)), values[i : i + 1])
    order = rng.permutation(11)
    moved = block._replace(**{name: getattr(block, name)[order] for name in ("x", "y", "x_hat", "u")})
    moved = moved._replace(P=block.P[order], M=block.M[order]) if per_run else moved
    np.testing.assert_array_equal(metric.evaluate(moved), values[order])


@pytest.mark.parametrize("metric", METRICS, ids=repr)
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_a_failed_run_does_not_change_the_others(metric, bad, rng):
    """Oracle: the bits without it; no input is changed."""
    block = trajectories(rng, per_run=True)
    values = metric.evaluate(block)
    failed = Record(0.5, *(each.copy() for each in block[1:5]), block.r, block.P.copy(), block.M.copy())
    failed = failed._replace(experiment=block.experiment)
    for signal in (failed.x, failed.x_hat, failed.y, failed.u):
        signal[1, 2:] = bad
    failed.P[1, 3:] = failed.M[1, 3:] = bad
    with np.errstate(all="ignore"):
        kept = [each.copy() for each in failed[1:8]]
        np.testing.assert_array_equal(np.delete(metric.evaluate(failed), 1), np.delete(values, 1))
    for each, before in zip(failed[1:8], kept, strict=True):
        np.testing.assert_array_equal(each, before)
