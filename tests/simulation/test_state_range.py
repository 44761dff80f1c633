"""Limits of the state: which runs fail, with which status, and that the others do not change."""

import numpy as np
import pytest
from simulation.test_closed_loop import RUNS, STEPS, TOY, others_unchanged, toy_draws
from simulation.toy import Delta, Halfway, Walk

from rmpc_bench.models import servo_kernel
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.open_loop import Rest
from rmpc_bench.simulation.state_range import LARGEST, RunLimits, StateRange
from rmpc_bench.types import Method, Motion, Status

OK, DIVERGED, OUT_OF_RANGE = (np.int8(each) for each in (Status.OK, Status.DIVERGED, Status.OUT_OF_RANGE))
FINE = np.zeros(3, dtype=np.int8)


def after(state_range, x, x0=((1.0, 2.0),) * 3, r=((0.0,),), reported=FINE):
    """Statuses of three runs after their states are x."""
    limits = RunLimits(state_range, np.array(x0), np.array(r))
    return limits.of_state(FINE, np.array(reported, dtype=np.int8), np.array(x)).tolist()


@pytest.mark.parametrize(
    ("x0", "r", "limit"),
    [(0.5, 0.2, 1e6), (-30.0, 0.2, 3e7), (0.5, -4.0, 4e6), (2.0, 3.0, 3e6)],
    ids=["one", "initial value", "reference", "largest of the three"],
)
def test_the_default_limit_is_a_million_times_the_scale(x0, r, limit):
    """Oracle: 1e6 times the largest of 1, the initial value and the reference; per state and run."""
    start = [[x0, 0.0], [0.0, x0], [0.0, 0.0]]
    other = 1e6 * max(1.0, abs(r))
    just, over = 1.0 - 1e-12, 1.0 + 1e-12
    assert after(StateRange(), [[limit * just, other * just]] * 2 + [[0, 0]], start, [[0.0], [r]])[0] == OK
    found = after(StateRange(), [[-limit * over, 0.0], [0.0, limit * over], [other * over, 0.0]], start, [[0.0], [r]])
    assert found == [DIVERGED] * 3


def test_a_limit_of_its_own_counts_per_state():
    """Oracle: the limits 10 and 1000 of the two states."""
    limits = StateRange(largest=np.array([10.0, 1000.0]))
    assert after(limits, [[11.0, 0.0], [9.0, 999.0], [0.0, -1001.0]]) == [DIVERGED, OK, DIVERGED]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_bounds_come_before_numbers(value):
    """Oracle: outside the bounds `out-of-range`, whatever the other states are; not a number is `diverged`."""
    bounds = StateRange(np.array([0.0, -np.inf]), np.array([5.0, np.inf]))
    assert after(bounds, [[-0.1, value], [1.0, value], [5.0, 2.0]]) == [OUT_OF_RANGE, DIVERGED, OK]
    assert after(bounds, [[np.nan, 1.0], [6.0, np.nan], [0.0, 0.0]]) == [DIVERGED, OUT_OF_RANGE, OK]


def test_a_reported_status_comes_first():
    """Oracle: what the plant reports is kept."""
    bounds = StateRange(np.array([0.0, 0.0]), np.array([5.0, 5.0]))
    assert after(bounds, [[9.0, 1.0]] * 3, reported=[Status.SINGULAR, 0, 0]) == [Status.SINGULAR, OUT_OF_RANGE, 2]


def test_estimates_and_inputs():
    """Oracle: the limits of the state; with another number of states the largest one; 1e100 for an input."""
    limits = RunLimits(StateRange(largest=np.array([10.0, 1000.0])), np.zeros((3, 2)), np.zeros((1, 1)))
    x_hat = np.array([[11.0, 0.0], [9.0, 999.0], [0.0, np.nan]])
    assert limits.of_estimate(FINE, FINE, x_hat).tolist() == [DIVERGED, OK, DIVERGED]
    assert limits.of_estimate(FINE, FINE, np.array([[11.0], [999.0], [1001.0]])).tolist() == [OK, OK, DIVERGED]
    assert limits.of_input(FINE, FINE, np.array([[1e99], [1e101], [np.nan]])).tolist() == [OK, DIVERGED, DIVERGED]


def test_the_first_failure_is_kept():
    """Oracle: a run that has failed keeps its status."""
    limits = RunLimits(StateRange(), np.zeros((3, 1)), np.zeros((1, 1)))
    failed = np.array([Status.EMPTY_SET, OK, OK], dtype=np.int8)
    assert limits.of_state(failed, FINE, np.array([[1e9], [1e9], [0.0]])).tolist() == [Status.EMPTY_SET, DIVERGED, OK]


def test_an_unstable_run_fails_and_the_others_have_the_same_bits(rng):
    """Oracle: the same block with a stable run in its place; the failed run keeps its last state."""
    draws, r = toy_draws(rng, [0.9] * RUNS), np.zeros((STEPS + 2, 1))
    wild = draws._replace(delta=Delta(np.array([0.9, 0.9, 300.0, 0.9, 0.9]), draws.delta.status))
    record, status = simulate(Walk(), Method("M", Halfway(), Rest(1)), wild, r, STEPS)
    expected, _ = simulate(Walk(), Method("M", Halfway(), Rest(1)), draws, r, STEPS)
    assert status.tolist() == [OK, OK, DIVERGED, OK, OK]
    others_unchanged(record, expected, 2)
    x = record.x[2, :, 0]
    limit = 1e6 * max(1.0, abs(x[0]))
    last = int(np.argmax(x == x[-1]))
    assert np.abs(x).max() <= limit < 300.0 * abs(x[last]) + 10.0
    np.testing.assert_array_equal(x[last:], np.full(STEPS + 1 - last, x[last]))


class Tank(Walk):
    """A tank that drains by the root of its level: below 0 its numbers have no meaning."""

    nx = 2

    def step(self, k, delta, x, u, w):
        """Drain, and put the root of a negative level into a second state."""
        with np.errstate(invalid="ignore"):
            level = x[:, :1] - 0.3 * np.sqrt(x[:, :1])
            root = np.sqrt(level)
        return Motion(np.hstack([level, root]), delta.status)

    def output(self, k, delta, x, v):
        """Measure the level."""
        return x[:, :1] + v


def test_a_tank_that_runs_empty_is_out_of_range_where_it_stood(rng):
    """Oracle: the level before the step that would make it negative; with the numbers asked first: `diverged`."""
    draws = toy_draws(rng, [0.9] * RUNS)._replace(
        x0=np.array([[0.5, 0.1], [50.0, 1.0], [0.9, 0.1], [60.0, 1.0], [0.2, 0.1]])
    )
    bounds = StateRange(np.array([0.0, -np.inf]), np.array([np.inf, np.inf]))
    still = Method("M", Halfway(), Rest(1))
    record, status = simulate(Tank(), still, draws, np.zeros((STEPS + 2, 1)), STEPS, state_range=bounds)
    assert status.tolist() == [OUT_OF_RANGE, OK, OUT_OF_RANGE, OK, OUT_OF_RANGE]
    assert (record.x[:, :, 0] >= 0.0).all()
    without, _ = simulate(Tank(), still, draws, np.zeros((STEPS + 2, 1)), STEPS)
    np.testing.assert_array_equal(record.x[[1, 3]], without.x[[1, 3]])
    assert simulate(Tank(), still, draws, np.zeros((STEPS + 2, 1)), STEPS)[1].tolist() == [
        DIVERGED,
        OK,
        DIVERGED,
        OK,
        DIVERGED,
    ]


def test_a_run_that_starts_outside_has_failed_from_the_start(rng):
    """Oracle: its initial state, which it keeps."""
    draws = toy_draws(rng, [0.9] * RUNS)
    draws.x0[3] = 99.0
    record, status = simulate(
        Walk(), TOY, draws, np.zeros((STEPS + 2, 1)), STEPS, state_range=StateRange(np.array([-50.0]), np.array([50.0]))
    )
    assert status.tolist() == [OK, OK, OK, OUT_OF_RANGE, OK]
    np.testing.assert_array_equal(record.x[3], np.full((STEPS + 1, 1), 99.0))


def test_kernels_have_the_largest_input_too():
    """Their copies, which numba compiles, end the same runs."""
    assert servo_kernel.LARGEST == LARGEST
