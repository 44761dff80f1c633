"""The bench's servomechanism against the references: the largest error over all samples of all loops, no quantile.

The references agree with one another to 1e-13 rad, and with forty digits to 1e-14 (`test_servo_references`), so what
is seen here is the plant's own error.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from plants.servo_loops import (
    ODD,
    Case,
    ReferencePlant,
    bang_bang,
    bench,
    durations,
    fig7,
    near_breakaway,
    random_states,
    short_episodes,
)
from plants.servo_reference import COARSE, FINE

from rmpc_bench import simulate
from rmpc_bench.types import Method, Status

ANGLE = 1e-11  # rad, what the plant promises for every sample
MSE = 1e-12  # rad^2, what it promises for the mean square over a run
OTHERS = 1e-9  # rad/s, rad, A: a state that is wrong at the last sample would show in no angle
METHODS = ("S-MPC", "R-MPC1", "R-MPC2", "R-MPC3")


def assert_accurate(cases: Sequence[Case]) -> None:
    """Compare the plant with the reference, all samples of all cases; the message holds the worst case."""
    ours, reference = bench(cases), np.array([case.reference()[0] for case in cases])
    off = np.abs(ours - reference).max(axis=1)
    worst = int(off[:, 0].argmax())
    assert off[worst, 0] <= ANGLE, (off[worst], cases[worst])
    worst = int(off.max(axis=1).argmax())
    assert off[worst].max() <= OTHERS, (off[worst], cases[worst])


def closed_loops(method: Method, runs: range, plant: Any) -> tuple[Any, Any, Any]:
    """Load angles (runs, samples), voltages (runs, steps) and mean square errors of the closed loops of Fig. 7."""
    experiment = fig7()
    r = experiment.scenario.reference.sample(experiment.n_steps + 1 + method.controller.preview)
    record, status = simulate(plant, method, experiment.scenario.draw(plant, runs, experiment.n_steps), r, 200)
    assert (status == Status.OK).all()
    (metric,) = (metric for metric in experiment.metrics if metric.name == "mse")
    return record.y[:, :, 0], record.u[:, :, 0], metric.evaluate(record)


def assert_closed_loops_accurate(name: str, runs: range) -> None:
    """Close the loop with the plant and with the reference, and replay the plant's voltages in the reference."""
    experiment = fig7()
    method, parameters = experiment.method(name), experiment.scenario.draw(ReferencePlant(), runs, 200).delta
    y, u, mse = closed_loops(method, runs, experiment.plant)
    y_reference, _, mse_reference = closed_loops(method, runs, ReferencePlant())
    assert np.abs(y - y_reference).max() <= ANGLE
    assert np.abs(mse - mse_reference).max() <= MSE
    for p, volts, ours in zip(parameters, u, y, strict=True):
        replayed = Case(p, volts).reference(COARSE)[0][:, 0]
        assert np.abs(ours - replayed).max() <= ANGLE, p


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.long
def test_closed_loops_are_accurate(name):
    """Oracle: the collocation reference in the loop, with the filters and the law of Fig. 7; 16 loops."""
    assert_closed_loops_accurate(name, range(4))


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_all_closed_loops_are_accurate(name):
    """Oracle: as above; with the other methods 800 loops."""
    assert_closed_loops_accurate(name, range(200))


def test_bang_bang_loops_are_accurate():
    """Oracle: collocation; several events in a sample, reversals at full speed."""
    assert_accurate(bang_bang(41, 60))


@pytest.mark.slow
def test_many_bang_bang_loops_are_accurate():
    assert_accurate(bang_bang(42, 1000))


def test_samples_from_all_over_the_state_space_are_accurate():
    """Oracle: collocation; the modes follow from the state alone, as after a kick by noise."""
    assert_accurate(random_states(43, 1000))


@pytest.mark.slow
def test_many_samples_are_accurate():
    assert_accurate(random_states(44, 20_000))
    assert_accurate(near_breakaway(45, 20_000))


def test_short_episodes_are_accurate():
    """Oracle: collocation; in every loop a body slips or sticks for 2 to 4 ms, or for less in the second set."""
    cases = short_episodes(20)
    for number, (body, slips) in enumerate((body, slips) for body in (0, 1) for slips in (False, True)):
        for case in cases[20 * number : 20 * (number + 1)]:
            episodes = [own for *kind, own in durations(case.reference(FINE)[1]) if kind == [body, slips]]
            assert any(2e-3 <= own <= 4e-3 for own in episodes)
    assert_accurate(cases)
    assert_accurate(near_breakaway(46, 300))


@pytest.mark.slow
def test_many_short_episodes_are_accurate():
    assert_accurate(short_episodes(200))
    assert_accurate(short_episodes(50, 1e-6, 1e-4))


@pytest.mark.parametrize("name", ODD)
def test_odd_plants_are_accurate(name):
    """Oracle: collocation; other inductances, friction laws, inertias and shafts."""
    changes = ODD[name]
    assert_accurate(bang_bang(47, 3, 20, **changes))
    assert_accurate(random_states(48, 50, **changes))
    assert_accurate(near_breakaway(49, 30, **changes))


@pytest.mark.slow
@pytest.mark.parametrize("name", ODD)
def test_many_loops_of_odd_plants_are_accurate(name):
    changes = ODD[name]
    assert_accurate(bang_bang(50, 20, 60, **changes))
    assert_accurate(random_states(51, 300, **changes))
    assert_accurate(near_breakaway(52, 300, **changes))
