"""The metric that picks one sample."""

from fractions import Fraction

import numpy as np
import pytest
from metrics.estimate_records import LAYOUT, N, method, plant, trajectories
from metrics.issue_checks import no_issue, only_issue

from rmpc_bench.metrics.sample import Sample
from rmpc_bench.metrics.tracking import Mse
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
    in_samples = block._replace(experiment=LAYOUT._replace(tick=1.0))
    np.testing.assert_array_equal(Sample(of=of, at=1.5).evaluate(block), pick(block, 3))
    np.testing.assert_array_equal(Sample(of=of, at=3.0).evaluate(in_samples), pick(block, 3))
    for metric in (Sample(of=of), Sample(of=of, at="N")):
        np.testing.assert_array_equal(metric.evaluate(block), pick(block, last))
        assert metric.window(LAYOUT) == (last, last)


def test_the_column_of_a_sample():
    """Oracle: outputs and inputs have units, the best value is 0."""
    units = [Sample(of=of).unit(LAYOUT) for of, _ in PICKS]
    assert units == ["", "", "", "rad", "V"]
    assert Sample(of="x.0").info(LAYOUT) == ("sample", "", "zero", False, "")
    assert Sample(of="x.0", name="x0_end").info(LAYOUT).name == "x0_end"


def test_a_sample_does_not_keep_the_trajectories_alive(rng):
    """Oracle: the values are no view."""
    assert Sample(of="x.0").evaluate(trajectories(rng)).base is None


@pytest.mark.parametrize(("of", "last"), [("x.0", N), ("u.0", N - 1)])
def test_a_sample_beyond_the_end(of, last):
    """Oracle: refused at `at`; in a smoke run, which is short, the last one."""
    no_issue(Sample(of=of, at=last * 0.5), LAYOUT)
    message = rf"{of} at sample {last + 1} lies beyond the last one, {last}"
    only_issue(Sample(of=of, at=(last + 1) * 0.5), LAYOUT, "at", message)
    smoke = LAYOUT._replace(cut=True)
    assert Sample(of=of, at=750.0).window(smoke) == (last, last)
    assert Sample(of=of, at=1.0).window(smoke) == (2, 2)


@pytest.mark.parametrize("of", ["x", "x.", "x.-1", "x.1.0", "z.0", "X.0", "x_hat", "w.0", " x.0", "", "x.²"])
def test_a_sample_of_something_that_is_no_component(of):
    """Oracle: the message says what can be written."""
    only_issue(Sample(of=of), LAYOUT, "of", r"must be x\.I, x_hat\.I, e\.I, y\.I, u\.I or u_command\.I")


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
    layout = LAYOUT._replace(plant=plant(5), methods=(method(5), method(4, name="S-MPC")))
    only_issue(Sample(of=of), layout, "of", message)
    for known in ("x.4", "y.0", "u.0", "x_hat.3"):
        no_issue(Sample(of=known), layout)


def test_a_missing_component_is_refused_at_evaluation_where_the_plant_is_not_known(rng):
    """Oracle: three states."""
    with pytest.raises(DesignError, match=r"there is no x\.3: choose x\.0 to x\.2"):
        Sample(of="x.3").evaluate(trajectories(rng))


def test_a_time_between_two_samples_is_refused():
    """As a duration is; up to 1e-9 of a sample it is the sample."""
    with pytest.raises(DesignError, match=r"0.14 is between the samples 1 and 2, as samples are 0.1 s apart"):
        Sample(of="x.0", at=0.14).window(LAYOUT._replace(tick=0.1))
    with pytest.raises(DesignError, match=r"2.5 is between the samples 2 and 3, as `time` is given in steps"):
        Sample(of="x.0", at=2.5).window(LAYOUT._replace(tick=1.0))
    assert Sample(of="x.0", at=3 * 0.1).window(LAYOUT._replace(tick=0.1)) == (3, 3)


def test_a_window_has_the_samples_inside_only(rng):
    """Oracle: exact fractions of the decimal numbers that the configuration gives, for every sample."""
    n = 60
    for tick in ("0.1", "0.05", "0.3", "1", "0.025"):
        layout = LAYOUT._replace(n_steps=n, tick=float(tick))
        for low, high in np.sort(rng.integers(0, 1000 * n, (40, 2)), axis=1) * Fraction(tick) / 1000:
            inside = [k for k in range(n + 1) if low <= k * Fraction(tick) <= high]
            metric = Mse(from_=float(low), to=float(high))
            if inside:
                assert metric.window(layout) == (inside[0], inside[-1])
            else:
                with pytest.raises(DesignError, match="at least one sample"):
                    metric.window(layout)
        # Every end at a sample, as 3 * 0.1 and as 0.3.
        ends = [float(k * Fraction(tick)) for k in range(n)]
        assert [Mse(from_=end, to=end).window(layout).first for end in ends] == [*range(n)]
        assert [Mse(from_=k * float(tick)).window(layout).first for k in range(n)] == [*range(n)]
    assert Mse(from_=0.05).window(LAYOUT._replace(tick=0.1)).first == 1  # half a step: not k = 0
