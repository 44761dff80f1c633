"""Metrics of bursts: the values of a run have the same bits alone and in a block, and a short run has no value."""

import pickle

import numpy as np
import pytest
from conftest import EXACT
from metrics.burst_records import INPUTS, PARTS, Mixed, Ts, trajectories

from rmpc_bench.metrics.departures import Departures
from rmpc_bench.metrics.norms import NORMS
from rmpc_bench.metrics.singular_poses import NearSingular
from rmpc_bench.metrics.tracking import Tracking
from rmpc_bench.types import MetricLayout

METRICS = [
    *(Tracking(norm=norm, smooth=1.5, during="quiet", memory=1.0) for norm in NORMS),
    Tracking(during="bursts", only=[1], unit_="mm"),
    *(kind(**part) for kind in INPUTS for part in PARTS[::3]),
    Departures(size=0.8, smooth=1.0),
    Departures(size=0.8, smooth=1.0, during="bursts"),
    NearSingular(),
]


def block_of(rng, *size):
    """Random trajectories of the plant with outputs in different units."""
    block = trajectories(rng, *size)
    return block._replace(experiment=block.experiment._replace(plant=Mixed()))


@pytest.mark.parametrize("metric", METRICS, ids=repr)
@pytest.mark.parametrize("n_steps", [1, 130])
def test_a_row_has_the_bits_it_has_alone(metric, n_steps, rng):
    """Oracle: a batch of one, in memory of its own; 130 samples make NumPy's sums pairwise."""
    block = block_of(rng, 11, n_steps)
    metric = pickle.loads(pickle.dumps(metric))
    values = metric.evaluate(block)
    for i in range(11):
        own = {name: getattr(block, name)[i : i + 1].copy() for name in ("x", "y", "x_hat", "u", "bursts")}
        np.testing.assert_allclose(metric.evaluate(block._replace(**own)), values[i : i + 1], **EXACT)


@pytest.mark.parametrize("metric", METRICS, ids=repr)
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_a_failed_run_does_not_change_the_others(metric, bad, rng):
    """Oracle: the bits without it; no input is changed; nothing warns but overflows."""
    block = block_of(rng)
    values = metric.evaluate(block)
    failed = block._replace(y=block.y.copy(), u=block.u.copy())
    failed.y[1, 2:], failed.u[1, 2:] = bad, bad
    kept = failed.y.copy(), failed.u.copy()
    with np.errstate(over="ignore", invalid="ignore"):  # as the simulation does
        np.testing.assert_array_equal(np.delete(metric.evaluate(failed), 1), np.delete(values, 1))
    np.testing.assert_array_equal(failed.y, kept[0])
    np.testing.assert_array_equal(failed.u, kept[1])


@pytest.mark.parametrize("metric", METRICS[:-1], ids=repr)
def test_a_short_run_without_bursts_has_no_value(metric, rng):
    """Oracle: NaN where no sample counts, without a warning; windows of a smoke run are cut."""
    block = trajectories(rng, 2, 3, spans=[[(90, 99)]])
    block = block._replace(experiment=MetricLayout(3, Ts, "m", "V", cut=True, bursts=True))
    values = metric.evaluate(block)
    # Departures over bursts count 0: their usual size comes from quiet samples.
    counted = metric.during == "bursts" and not isinstance(metric, Departures)
    assert np.isnan(values).all() if counted else np.isfinite(values).all()
