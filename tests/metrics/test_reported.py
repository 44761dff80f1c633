"""Metrics of what methods report of themselves: records made by hand, plain loops, and a whole loop of toys."""

import math
import pickle
import statistics

import numpy as np
import pytest
from conftest import ROUND
from metrics.burst_records import LAYOUT, PARTS, N, counts, trajectories
from metrics.issue_checks import only_issue
from simulation.toy import Halfway, Proportional, Walk

from rmpc_bench.metrics.reported import Fallbacks, Reported
from rmpc_bench.noise.bounded import uniform
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.simulation.reference import constant
from rmpc_bench.simulation.scenario import Experiment, Scenario
from rmpc_bench.types import Method


class Watching(Halfway):
    """An estimator that reports a fallback at every third sample, and a vector."""

    reports = {"fallback": (), "r": (2,)}

    def correct(self, k, state, y):
        """Report."""
        state, estimate = super().correct(k, state, y)
        info = {"fallback": np.full(len(y), float(k % 3 == 0)), "r": np.stack([y[:, 0], 2.0 * y[:, 0]], axis=1)}
        return state, estimate._replace(info=info)


class Tuned(Proportional):
    """A controller that reports a matrix, from k = 4 on."""

    reports = {"Q_yw": (2, 2)}

    def control(self, k, state, y, estimate, r):
        """Report."""
        state, command = super().control(k, state, y, estimate, r)
        M = np.array([[4.0, float(k)], [-1.0, 9.0]]) if k >= 4 else np.full((2, 2), np.nan)
        return state, command._replace(info={"Q_yw": np.tile(M, (len(y), 1, 1))})


BOTH = Method("tuned", Watching(), Tuned())
PLAIN = Method("plain", Halfway(), Proportional())
KNOWN = LAYOUT._replace(methods=(BOTH,))


def block_of(rng, late=0):
    """Random trajectories with a 2 x 2 matrix and a number, unknown before k = `late`."""
    block = trajectories(rng)
    Q = rng.standard_normal((len(block.y), N, 4)) + [5.0, 0.0, 0.0, 5.0]
    Q[:, :late] = np.nan
    r = rng.standard_normal((len(block.y), N + 1, 2))
    return block._replace(info={"Q_yw": Q, "r": r}, experiment=KNOWN)


REDUCTIONS = {
    "median": statistics.median,
    "mean": statistics.fmean,
    "std": statistics.pstdev,
    "min": min,
    "max": max,
    "sum": math.fsum,
}


@pytest.mark.parametrize("reduce", REDUCTIONS)
@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize(("late", "bounds", "first"), [(0, {}, 0), (12, {}, 12), (3, {"from_": 4.0, "to": 20.0}, 8)])
def test_reports_against_plain_loops(reduce, part, late, bounds, first, rng):
    """Oracle: Python's statistics over the samples that count; what is not known yet is left out."""
    block, last = block_of(rng, late), 41 if bounds else N
    for component, places in ((None, range(4)), ("0,1", [1]), (["0,0", "1, 1"], [0, 3])):
        values = Reported(of="Q_yw", component=component, reduce=reduce, **part, **bounds).evaluate(block)
        for i, value in enumerate(values):
            ks = [k for k in range(first, last) if counts(i, k, **part)]
            numbers = [float(block.info["Q_yw"][i, k, place]) for k in ks for place in places]
            expected = REDUCTIONS[reduce](numbers) if numbers else np.nan
            np.testing.assert_allclose(value, expected, rtol=1e-12, atol=1e-13)  # sums about 0


def test_the_last_report(rng):
    """Oracle: indexing; the last sample of the window that counts, of one component."""
    block = block_of(rng)
    value = Reported(of="Q_yw", component="1,0", reduce="last").evaluate(block)
    np.testing.assert_array_equal(value, block.info["Q_yw"][:, N - 1, 2])
    value = Reported(of="r", component=1, reduce="last", to=5.0).evaluate(block)
    np.testing.assert_array_equal(value, block.info["r"][:, 10, 1])


def test_normalised_entries(rng):
    """Oracle: M_ij / sqrt(M_ii M_jj) by hand; the diagonal is 1; no number where a diagonal entry is 0."""
    block = block_of(rng)
    block.info["Q_yw"][0, 7] = [0.0, 1.0, 1.0, 4.0]
    block.info["Q_yw"][:, 8] = [4.0, 3.0, -6.0, 9.0]
    keys = {"of": "Q_yw", "normalised": True, "reduce": "last"}
    at = {name: Reported(component=name, to=4.0, **keys).evaluate(block) for name in ("0,0", "0,1", "1,0")}
    for name, expected in (("0,0", 1.0), ("0,1", 0.5), ("1,0", -1.0)):
        np.testing.assert_allclose(at[name], expected, **ROUND)
    alone = Reported(component="0,1", from_=3.5, to=3.5, **keys).evaluate(block)
    assert np.isnan(alone[0]) and np.isfinite(alone[1:]).all()


def test_what_is_missing_in_a_record(rng):
    """Oracle: no value; no fallback where none is reported."""
    block = trajectories(rng)
    assert np.isnan(Reported(of="Q_yw").evaluate(block)).all()
    np.testing.assert_array_equal(Fallbacks().evaluate(block), np.zeros(4))


def test_fallbacks_are_counted(rng):
    """Oracle: a loop; what is no number is no fallback."""
    fell = (rng.random((4, N + 1, 1)) < 0.3).astype(float)
    fell[:, 0] = np.nan
    block = trajectories(rng)._replace(info={"fallback": fell})
    for bounds, samples in (({}, range(N)), ({"from_": 4.0, "to": "N"}, range(8, N + 1))):
        expected = [sum(fell[i, k, 0] == 1.0 for k in samples) for i in range(4)]
        np.testing.assert_array_equal(Fallbacks(**bounds).evaluate(block), expected)
    assert Fallbacks().info(LAYOUT) == ("fallbacks", "", "lower", False, "")


@pytest.mark.parametrize(
    ("keys", "parameter", "message"),
    [
        ({"of": "Pi"}, "of", r"'Pi' is not reported by 'tuned' \(which reports Q_yw, fallback, r\)"),
        ({"of": "Q_yw", "component": "2,0"}, "component", r"Q_yw has 2 x 2 entries and no '2,0'; choose \"0,0\" to"),
        ({"of": "Q_yw", "component": 1}, "component", "no '1'"),
        ({"of": "Q_yw", "component": ["0,0", "x"]}, "component", "no 'x'"),
        ({"of": "Q_yw", "component": []}, "component", "at least one"),
        ({"of": "r", "component": 2}, "component", r"r has 2 entries and no '2'; choose \"0\" to \"1\""),
        ({"of": "fallback", "component": 0}, "component", "fallback has one entry and no '0'; leave component out"),
        ({"of": "r", "normalised": True}, "normalised", "only a square matrix"),
        ({"of": "Q_yw", "reduce": "last"}, "component", "4 are selected"),
    ],
)
def test_issues(keys, parameter, message, bursts=True):
    """Oracle: what the toys report; the issue names the key to blame."""
    only_issue(Reported(**keys), KNOWN._replace(bursts=bursts), parameter, message)


def test_bursts_are_required():
    """Oracle: the noise has none."""
    test_issues({"of": "Q_yw", "during": "bursts"}, "during", "needs bursts", bursts=False)


def test_every_method_must_report():
    """Oracle: those that do not are named with what they have; two shapes of one name cannot be compared."""
    layout = LAYOUT._replace(methods=(BOTH, PLAIN))
    only_issue(Reported(of="Q_yw"), layout, "of", r"'Q_yw' is not reported by 'plain' \(which reports nothing\); leave")
    other = Proportional()
    other.reports = {"r": (3,)}
    layout = LAYOUT._replace(methods=(BOTH, Method("other", Halfway(), other)))
    only_issue(Reported(of="r"), layout, "of", "'r' has 2 entries or 3 entries, depending on the method")
    assert BOTH.reports == {"fallback": (), "r": (2,), "Q_yw": (2, 2)} and PLAIN.reports == {}


def test_a_row_has_the_bits_it_has_alone(rng):
    """Oracle: a batch of one."""
    block = block_of(rng, 5)
    for reduce in REDUCTIONS:
        metric = pickle.loads(pickle.dumps(Reported(of="Q_yw", reduce=reduce, during="quiet", normalised=True)))
        values = metric.evaluate(block)
        for i in range(4):
            own = {name: getattr(block, name)[i : i + 1].copy() for name in ("x", "y", "x_hat", "u", "bursts")}
            own["info"] = {name: value[i : i + 1].copy() for name, value in block.info.items()}
            np.testing.assert_array_equal(metric.evaluate(block._replace(**own)), values[i : i + 1])


def test_reports_go_through_the_loop():
    """Oracle: what the toys report, by hand, and the samples that are in the burst; nothing else is kept."""
    law = uniform(1, 0.5, radius=0.1, bursts=[Burst(3.0, 4.0, 2.0)])  # samples 6 to 8
    scenario = Scenario(7, {}, {}, np.zeros(1), (), (), (law,), constant(1, value=1.0))
    made = (
        Reported(of="Q_yw", component="0,1", reduce="sum"),
        Reported(of="Q_yw", component="0,1", reduce="mean", during="bursts"),
        Reported(of="Q_yw", component=["0,0", "1,1"], reduce="sum", during="quiet"),
        Fallbacks(),
        Fallbacks(to="N"),
        Reported(of="r", component=1, reduce="last"),
    )
    experiment = Experiment(Walk(), (BOTH,), scenario, made, 3, 12, tick=0.5)
    values = simulate_block(experiment, BOTH, range(3)).metrics
    np.testing.assert_array_equal(values[:5], np.tile([[sum(range(4, 12))], [7.0], [5 * 13.0], [4], [5]], 3))
    assert np.isfinite(values[5]).all()
