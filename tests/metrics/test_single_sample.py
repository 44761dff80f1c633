"""The metric that picks one sample."""

import numpy as np
import pytest
from metrics.test_metrics_of_estimates import UNITS, N, method, plant, trajectories

from rmpc_bench.metrics.single_sample import sample
from rmpc_bench.types import DesignError

PICKS = [
    ("x.1", lambda block, k: block.x[:, k, 1]),
    ("x_hat.2", lambda block, k: block.x_hat[:, k, 2]),
    ("e.0", lambda block, k: block.x[:, k, 0] - block.x_hat[:, k, 0]),
    ("y.1", lambda block, k: block.y[:, k, 1]),
    ("u.0", lambda block, k: block.u[:, k, 0]),
]


@pytest.mark.parametrize(("of", "pick"), PICKS)
def test_a_sample_against_indexing(of, pick, rng):
    """Oracle: the entry itself, bit for bit; seconds or samples, and N, which for an input is N-1."""
    block, last = trajectories(rng), N - (of == "u.0")
    for k, metric in ((3, sample(UNITS, of=of, at=1.5)), (3, sample(UNITS._replace(tick=1.0), of=of, at=3.0))):
        np.testing.assert_array_equal(metric.evaluate(block), pick(block, k))
    for metric in (sample(UNITS, of=of), sample(UNITS, of=of, at="N")):
        np.testing.assert_array_equal(metric.evaluate(block), pick(block, last))
        assert metric.window == (last, last)


def test_a_sample_says_what_it_is():
    """Oracle: outputs and inputs have units, the best value is 0."""
    units = [sample(UNITS, of=of).info.unit for of, _ in PICKS]
    assert units == ["", "", "", "rad", "V"]
    assert sample(UNITS, of="x.0").info == ("sample", "", "zero", False)
    assert sample(UNITS, of="x.0", name="x0_end").info.name == "x0_end"


def test_a_sample_does_not_keep_the_trajectories_alive(rng):
    """Oracle: the values are no view."""
    assert sample(UNITS, of="x.0").evaluate(trajectories(rng)).base is None


@pytest.mark.parametrize(("of", "last"), [("x.0", N), ("u.0", N - 1)])
def test_a_sample_beyond_the_end(of, last):
    """Oracle: refused at `at`; in a smoke run, which is short, the last one."""
    sample(UNITS, of=of, at=last * 0.5)
    with pytest.raises(DesignError, match=rf"{of} at sample {last + 1} lies beyond the last one, {last}") as caught:
        sample(UNITS, of=of, at=(last + 1) * 0.5)
    assert caught.value.parameter == "at"
    smoke = UNITS._replace(cut=True)
    assert sample(smoke, of=of, at=750.0).window == (last, last)
    assert sample(smoke, of=of, at=1.0).window == (2, 2)


@pytest.mark.parametrize("of", ["x", "x.", "x.-1", "x.1.0", "z.0", "X.0", "x_hat", "w.0", " x.0", "", "x.²"])
def test_a_sample_of_what_is_no_component(of):
    """Oracle: the message says what can be written."""
    with pytest.raises(DesignError, match=r"must be x\.I, x_hat\.I, e\.I, y\.I or u\.I") as caught:
        sample(UNITS, of=of)
    assert caught.value.parameter == "of"


@pytest.mark.parametrize(
    ("of", "message"),
    [
        ("x.5", r"no x\.5: choose x\.0 to x\.4"),
        ("y.1", r"no y\.1: choose y\.0 \(they count from 0\)"),
        ("u.7", r"no u\.7: choose u\.0 "),
        ("x_hat.4", r"no x_hat\.4 of method 'S-MPC': choose x_hat\.0 to x_hat\.3"),
        ("e.0", r"x_hat of method 'S-MPC' has 4 components and x of the plant 5"),
    ],
)
def test_a_component_that_is_not_there(of, message):
    """Oracle: a plant of five states, one output and one input, and a filter that knows four states."""
    units = UNITS._replace(plant=plant(5), methods=(method(5), method(4, name="S-MPC")))
    with pytest.raises(DesignError, match=message) as caught:
        sample(units, of=of)
    assert caught.value.parameter == "of"
    for known in ("x.4", "y.0", "u.0", "x_hat.3"):
        sample(units, of=known)


def test_a_component_that_nobody_could_know_is_missing_is_refused_at_last(rng):
    """Oracle: three states; better late than the wrong one."""
    with pytest.raises(DesignError, match=r"there is no x\.3: choose x\.0 to x\.2"):
        sample(UNITS, of="x.3").evaluate(trajectories(rng))
