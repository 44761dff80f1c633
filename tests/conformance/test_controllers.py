"""Every registered controller: the rules of the base class, bit for bit."""

import inspect
import pickle

import numpy as np
import pytest
from conftest import random_model

from rmpc_bench import registry
from rmpc_bench.controllers.mpc import Limits, Scale
from rmpc_bench.controllers.noise_tuning import LpNoise
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.estimators.kalman_disturbance import design as kalman_disturbance
from rmpc_bench.estimators.set_membership import design as set_membership
from rmpc_bench.types import Controller, Estimate, Status

KINDS = registry.names("controllers")
PARAMETERS = {
    "gpc": [
        {"Np": 4, "Q_yw": 1.0, "Q_u": 0.1},
        {"Np": 4, "Q_yw": 1.0, "Q_u": 0.1, "tuning": LpNoise(Ne2=4, kp=0.3)},
        {"Np": 2, "Q_yw": 1.0, "Q_u": 0.1, "tuning": LpNoise(Ne2=4, kp=0.3, on="residual", weight="square")},
    ],
    "mpc": [
        {"Hp": 6, "Hu": 2, "Q": 1.0, "R": 0.1, "limits": Limits(u=(-0.3, 0.3))},
        {"Hp": 3, "Hu": 3, "Q": 1.0, "R": 0.1, "scale": Scale(u=2.0, y=3.0)},
        {"Hp": 4, "Hu": 2, "Q": 1.0, "R": 0.1, "law": "printed"},
    ],
    "minimax-lq": [
        {"horizon": 7, "Q_x": 1.0, "R_u": 0.1},
        {"horizon": 5, "Q_x": 1.0, "R_u": 0.1, "set": "product"},
        {"horizon": 2, "Q_x": 1.0, "R_u": 0.1, "set": "stages"},
        {"horizon": 4, "Q_x": 1.0, "R_u": 0.1, "of": "data"},
    ],
    "lqr": [
        {"horizon": 7, "Q_x": 1.0, "R_u": 0.1},
        {"horizon": 7, "Q_x": 1.0, "R_u": 0.1, "mean": "estimated", "of": "mean"},
    ],
    "game-gain": [{"horizon": 7, "Q_x": 1.0, "R_u": 0.1, "ratio": 1.5}],
}
"""Parameters that make a design of each kind, `of` a filter if not a Kalman filter's; a new kind gets a line here."""
SIZES = [(1, 1, 1), (3, 2, 2), (4, 1, 2)]
CASES = [
    (kind, number, size)
    for kind in KINDS
    for number, parameters in enumerate(PARAMETERS.get(kind, []))
    for size in (SIZES if parameters.get("set") != "stages" else SIZES[1:2])  # a search per run and step: milliseconds
]
RUNS, STEPS = 9, 12


def test_every_registered_kind_is_tested():
    """Oracle: the registry."""
    assert sorted(PARAMETERS) == KINDS


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0]}-{case[1]}-{''.join(map(str, case[2]))}")
def case(request):
    """Return a design with estimates (runs, samples, nx), measurements (runs, samples, ny) and a reference."""
    kind, number, (nx, nu, ny) = request.param
    rng = np.random.default_rng(12)
    model = random_model(rng, nx, nu, ny, 0.9)
    make, provided = registry.get("controllers", kind), {}
    if "estimator" in inspect.signature(make).parameters:
        start = {"x0": np.zeros(nx), "P0": np.eye(nx)}
        parameters = dict(PARAMETERS[kind][number])
        filter_of = {"data": data_dependent, "mean": kalman_disturbance}.get(parameters.pop("of", ""), kalman)
        provided = {"n_steps": STEPS, "estimator": filter_of(model, STEPS, **start)}
        design = make(model, **provided, **parameters)
    else:
        design = make(model, **PARAMETERS[kind][number])
    r = rng.standard_normal((STEPS + design.preview, ny))
    return design, rng.standard_normal((RUNS, STEPS, nx)), rng.standard_normal((RUNS, STEPS, ny)), r, model


def data_dependent(model, n_steps, **start):
    """A filter with a set of its own for every run."""
    return set_membership(model, n_steps, **start, M0=np.eye(model.nx), update="maksarov-norton")


def estimated(x_hat):
    """An estimate with all that a law may ask for, a set per run and a mean of the noise."""
    M = np.eye(x_hat.shape[1]) * (1.0 + x_hat[:, :1] ** 2)[:, :, None]
    return Estimate(x_hat, None, M, np.zeros(len(x_hat), dtype=np.int8), {"w_mean": 0.1 * x_hat})


def call(design, k, state, x_hat, y, r):
    """One step of the law at k."""
    parts = [np.ascontiguousarray(part[:, k]) for part in (x_hat, y)]
    return design.control(k, state, parts[1], estimated(parts[0]), r[k : k + design.preview])


def commands(design, x_hat, y, r):
    """Commands of a block over time."""
    state, results = design.init(len(y)), []
    for k in range(STEPS):
        state, command = call(design, k, state, x_hat, y, r)
        results.append(command)
    return results


def inputs(design, x_hat, y, r):
    """Inputs of a block, (runs, samples, nu)."""
    return np.stack([command.u for command in commands(design, x_hat, y, r)], axis=1)


def test_it_is_a_controller(case):
    """Oracle: the base class; a design is frozen; r(k) at least is seen."""
    design = case[0]
    assert isinstance(design, Controller)
    assert design.preview >= 1
    with pytest.raises(AttributeError):
        design.something_new = 1


def test_shapes_and_statuses(case):
    """Oracle: axis 0 is the run; status is int8."""
    design, x_hat, y, r, model = case
    assert all(len(part) == RUNS for part in design.init(RUNS))
    for command in commands(design, x_hat, y, r):
        assert command.u.shape == (RUNS, model.nu) and command.u.dtype == np.float64
        np.testing.assert_array_equal(command.status, np.full(RUNS, Status.OK, dtype=np.int8))
        assert command.status.dtype == np.int8
        assert all(len(values) == RUNS for values in command.info.values())


def test_arguments_are_left_alone(case):
    """Oracle: copies of the state, the estimate, the measurement and the reference taken before the call."""
    design, x_hat, y, r, _ = case
    state = design.init(RUNS)
    for k in range(3):
        estimate = estimated(x_hat[:, k])
        before = [part.copy() for part in (*state, x_hat, y, r, estimate.status)]
        new, _ = design.control(k, state, y[:, k], estimate, r[k : k + design.preview])
        for part, copy in zip((*state, x_hat, y, r, estimate.status), before, strict=True):
            np.testing.assert_array_equal(part, copy)
        state = new


def test_the_same_call_twice_gives_the_same_bits(case):
    """Oracle: a step is pure, so an old state can be used again."""
    design, x_hat, y, r, _ = case
    state = design.init(RUNS)
    for k in range(3):
        (a, first), (b, second) = (call(design, k, state, x_hat, y, r) for _ in range(2))
        np.testing.assert_array_equal(first.u, second.u)
        for left, right in zip(a, b, strict=True):
            np.testing.assert_array_equal(left, right)
        state = a


def test_a_row_equals_a_batch_of_one(case):
    """Oracle: each run alone, bit for bit."""
    design, x_hat, y, r, _ = case
    together = inputs(design, x_hat, y, r)
    for i in range(RUNS):
        np.testing.assert_array_equal(inputs(design, x_hat[i : i + 1], y[i : i + 1], r), together[i : i + 1])


def test_permuting_runs_permutes_results(case):
    """Oracle: the runs in another order, bit for bit."""
    design, x_hat, y, r, _ = case
    order = np.random.default_rng(5).permutation(RUNS)
    np.testing.assert_array_equal(inputs(design, x_hat[order], y[order], r), inputs(design, x_hat, y, r)[order])


def test_a_pickle_gives_the_same_bits(case):
    """Oracle: the design before its trip to a worker."""
    design, x_hat, y, r, _ = case
    copy = pickle.loads(pickle.dumps(design))
    np.testing.assert_array_equal(inputs(copy, x_hat, y, r), inputs(design, x_hat, y, r))


def test_a_missing_estimate_leaves_the_other_runs_alone(case):
    """Oracle: the block without it, bit for bit; the run's input does not pretend to be one."""
    design, x_hat, y, r, _ = case
    broken_x, broken_y = x_hat.copy(), y.copy()
    broken_x[4, 3], broken_y[4, 3] = np.nan, np.nan
    ours, expected = inputs(design, broken_x, broken_y, r), inputs(design, x_hat, y, r)
    np.testing.assert_array_equal(np.delete(ours, 4, axis=0), np.delete(expected, 4, axis=0))
    np.testing.assert_array_equal(ours[4, :3], expected[4, :3])
    assert np.isnan(ours[4, 3]).all()
