"""Metrics of bursts: a run has the bits it has alone, whatever the others do, and a short run is no mistake."""

import pickle

import numpy as np
import pytest
from conftest import EXACT
from metrics.burst_records import INPUTS, PARTS, UNITS, Mixed, Ts, trajectories

from rmpc_bench.metrics.bursts import NORMS, tracking
from rmpc_bench.metrics.departures import departures
from rmpc_bench.metrics.singular_poses import near_singular
from rmpc_bench.metrics.tracking import Units

MAKES = [
    *(lambda units, norm=norm: tracking(units, norm=norm, smooth=1.5, during="quiet", memory=1.0) for norm in NORMS),
    lambda units: tracking(units, during="bursts", components=[1], unit="mm"),
    *(lambda units, make=make, part=part: make(units, **part) for make in INPUTS for part in PARTS[::3]),
    lambda units: departures(units, size=0.8, smooth=1.0),
    lambda units: departures(units, size=0.8, smooth=1.0, during="bursts"),
    lambda units: near_singular(units._replace(plant=Mixed())),
]


@pytest.mark.parametrize("make", MAKES)
@pytest.mark.parametrize("n_steps", [1, 130])
def test_a_row_has_the_bits_it_has_alone(make, n_steps, rng):
    """Oracle: a batch of one, in memory of its own; 130 samples make NumPy's sums pairwise."""
    block = trajectories(rng, 11, n_steps)
    metric = pickle.loads(pickle.dumps(make(UNITS._replace(n_steps=n_steps))))
    values = metric.evaluate(block)
    for i in range(11):
        own = {name: getattr(block, name)[i : i + 1].copy() for name in ("x", "y", "x_hat", "u", "bursts")}
        np.testing.assert_allclose(metric.evaluate(block._replace(**own)), values[i : i + 1], **EXACT)


@pytest.mark.parametrize("make", MAKES)
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_a_wild_run_leaves_the_others_alone(make, bad, rng):
    """Oracle: the bits without it; no input is changed; it warns of nothing but of sizes."""
    block = trajectories(rng)
    values = make(UNITS).evaluate(block)
    wild = block._replace(y=block.y.copy(), u=block.u.copy())
    wild.y[1, 2:], wild.u[1, 2:] = bad, bad
    kept = wild.y.copy(), wild.u.copy()
    with np.errstate(over="ignore", invalid="ignore"):  # as the simulation does
        np.testing.assert_array_equal(np.delete(make(UNITS).evaluate(wild), 1), np.delete(values, 1))
    np.testing.assert_array_equal(wild.y, kept[0])
    np.testing.assert_array_equal(wild.u, kept[1])


@pytest.mark.parametrize("make", MAKES[:-1])
def test_a_short_run_without_bursts_has_no_value(make, rng):
    """Oracle: NaN where no sample counts, without a warning; windows of a smoke run are cut."""
    block = trajectories(rng, 2, 3, spans=[[(90, 99)]])
    metric = make(Units(3, Ts, "m", "V", cut=True, bursts=True))
    during = getattr(metric.reduce, "during", None)
    values = metric.evaluate(block)
    assert np.isnan(values).all() if during is not None and during.when == "bursts" else np.isfinite(values).all()
