"""Metrics of states, estimates and samples: a run has the bits it has alone, whatever the others do."""

import pickle

import numpy as np
import pytest
from metrics.test_metrics_of_estimates import SIZES, UNITS, trajectories

from rmpc_bench import registry
from rmpc_bench.metrics import estimation
from rmpc_bench.metrics.tracking import Units
from rmpc_bench.types import Record

MAKES = [
    *(lambda units, make=make, of=of: make(units, of=of) for make in SIZES for of in ("state", "estimate")),
    estimation.estimation_mse,
    estimation.nees,
    *(lambda units, of=of: registry.get("metrics", "inside")(units, of=of) for of in (None, "set", "gaussian", "sum")),
    lambda units: registry.get("metrics", "cost")(units, Q_x=[3.0, 0.1, 1.0], R_u=0.7),
    *(lambda units, of=of: registry.get("metrics", "sample")(units, of=of) for of in ("x.1", "e.2", "y.1", "u.0")),
]


def row(block, i):
    """Run i as a batch of one, in memory of its own."""
    beliefs = (part if part.ndim == 3 else part[i : i + 1].copy() for part in (block.P, block.M))
    return Record(block.Ts, *(part[i : i + 1].copy() for part in block[1:5]), block.r, *beliefs)


@pytest.mark.parametrize("make", MAKES)
@pytest.mark.parametrize("per_run", [False, True])
@pytest.mark.parametrize("n_steps", [1, 130])
def test_a_row_has_the_bits_it_has_alone(make, per_run, n_steps, rng):
    """Oracle: a batch of one; 130 samples of 3 states make NumPy's sums pairwise."""
    block = trajectories(rng, 11, n_steps, per_run=per_run)
    metric = pickle.loads(pickle.dumps(make(Units(n_steps, 1.0, "m", "V"))))
    values = metric.evaluate(block)
    for i in range(11):
        np.testing.assert_array_equal(metric.evaluate(row(block, i)), values[i : i + 1])
    order = rng.permutation(11)
    moved = block._replace(**{name: getattr(block, name)[order] for name in ("x", "y", "x_hat", "u")})
    moved = moved._replace(P=block.P[order], M=block.M[order]) if per_run else moved
    np.testing.assert_array_equal(metric.evaluate(moved), values[order])


@pytest.mark.parametrize("make", MAKES)
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_a_wild_run_leaves_the_others_alone(make, bad, rng):
    """Oracle: the bits without it; no input is changed."""
    block = trajectories(rng, per_run=True)
    metric = make(UNITS)
    values = metric.evaluate(block)
    wild = Record(0.5, *(part.copy() for part in block[1:5]), block.r, block.P.copy(), block.M.copy())
    for part in (wild.x, wild.x_hat, wild.y, wild.u):
        part[1, 2:] = bad
    wild.P[1, 3:] = wild.M[1, 3:] = bad
    with np.errstate(all="ignore"):
        kept = [part.copy() for part in wild[1:8]]
        np.testing.assert_array_equal(np.delete(metric.evaluate(wild), 1), np.delete(values, 1))
    for part, before in zip(wild[1:8], kept, strict=True):
        np.testing.assert_array_equal(part, before)
