"""What makes the moving-horizon estimator fail: statuses of runs, and errors of a design."""

import numpy as np
import pytest
from estimators.state_dependent_models import Mass
from estimators.test_moving_horizon import KALMAN, RAO, half_normal_data, run, x_hat

from rmpc_bench.estimators import kalman
from rmpc_bench.estimators.moving_horizon import design
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.mixed_noise import design as mixed_model
from rmpc_bench.models.uncertain_linear import design as uncertain_model
from rmpc_bench.numerics.qp import QpStatus, QuadraticProgram
from rmpc_bench.types import DesignError, Status


def test_bounds_that_cannot_be_met():
    """Oracle: by hand; x grows at most by 1 a step, and y asks for 10 with v in [-1, 1]; the other run goes on."""
    model = LinearModel([[1.0]], [[1.0]], [[1.0]], 1.0, 1.0)
    made = design(model, 5, x0=np.zeros(1), P0=np.zeros((1, 1)), window=3, w=(-1.0, 1.0), v=(-1.0, 1.0))
    y = np.array([[0.0, 0.5, 10.0, 0.0], [0.0, 0.5, 1.5, 1.0]])[:, :, None]
    found = run(made, y, np.zeros_like(y))
    status = np.array([each.status for each in found])
    assert status[:, 0].tolist()[:3] == [Status.OK, Status.OK, Status.INFEASIBLE]
    assert not status[:, 1].any() and np.isfinite([each.x_hat[1] for each in found]).all()


def test_a_known_state_outside_its_bounds_is_infeasible():
    """Oracle: x(0) = 2 is exact (P0 = 0); bounds that end there are met, to rounding."""
    model = LinearModel([[0.7]], [[1.0]], [[1.0]], 1.0, 1.0)
    start, y = {"x0": np.array([2.0]), "P0": np.zeros((1, 1)), "window": 2}, np.ones((1, 3, 1))
    for high, expected in ((1.9, Status.INFEASIBLE), (2.0, Status.OK)):
        assert run(design(model, 2, **start, x=(None, high)), y, 0.0 * y)[0].status[0] == expected


def test_a_failed_solver_ends_the_run(monkeypatch, rng):
    """Oracle: every result of the solver but `infeasible` and the solved ones is `not-converged`."""
    _, y, u = half_normal_data(rng, 2, 3)
    made = design(mixed_model(3, **RAO), 3, x0=np.zeros(2), P0=np.eye(2), w=(0.0, None), x=(None, -5.0))
    for result in (QpStatus.ITERATION_LIMIT, QpStatus.FAILED):
        monkeypatch.setattr(QuadraticProgram, "solve_block", lambda self, f, *_, r=result: (np.nan * f, [r] * len(f)))
        last = run(made, y, u)[-1]
        np.testing.assert_array_equal(last.status, np.full(2, Status.NOT_CONVERGED))
        assert np.isfinite(last.x_hat).all() and last.info["solved"].all()


def test_an_infinite_measurement_spoils_its_own_run_only(rng):
    """Oracle: the other run alone, bit for bit; the closed loop ends a run whose estimate is not finite."""
    _, y, u = half_normal_data(rng, 2, 8)
    made = design(mixed_model(8, **RAO), 8, x0=np.zeros(2), P0=np.eye(2), window=3, w=(0.0, None))
    alone = x_hat(made, y[:1], u[:1])
    y[1, 4] = np.inf
    with np.errstate(invalid="ignore"):  # inf - inf
        both = x_hat(made, y, u)
    np.testing.assert_array_equal(both[0], alone[0])
    assert not np.isfinite(both[1, 4]).any()


@pytest.mark.parametrize(
    ("keys", "text", "key"),
    [
        ({"w": (1.0, 0.0)}, "must not exceed", "w"),
        ({"x": [(0.0, 1.0)] * 3}, "has 3 pairs, and 2 are required", "x"),
        ({"v": [(0.0, 1.0)] * 2}, "has 2 pairs, and 1 is required", "v"),
        ({"x": (np.nan, 1.0)}, "must not exceed", "x"),
        ({"x": (np.inf, np.inf)}, "no number satisfies", "x"),
        ({"x": (None, np.inf)}, "has no bound", "x"),
        ({"w": (0.1, 1.0)}, r"coordinate 0 of the noise is always 0 .*\[0.1, 1\]", "w"),
    ],
)
def test_bounds_that_do_not_fit(keys, text, key):
    """Oracle: the key and the way out in the message."""
    with pytest.raises(DesignError, match=text) as caught:
        design(mixed_model(5, **RAO), 5, x0=np.zeros(2), P0=np.eye(2), **keys)
    assert caught.value.parameter == key


def test_models_that_do_not_fit():
    """Oracle: the message; a state-dependent model, correlated noises, process noise of two sources."""
    start = {"x0": np.zeros(2), "P0": np.eye(2)}
    with pytest.raises(DesignError, match="use kalman"):
        design(Mass(), 5, **start)
    A, C = np.array(RAO["A"]), np.array(RAO["C"])
    with pytest.raises(DesignError, match="uncorrelated"):
        design(LinearModel(A, np.zeros((2, 1)), C, 1.0, 1.0, S_wv=[[0.1], [0.0]]), 5, **start)
    with pytest.raises(DesignError, match="innovation is singular at k = 0"):
        design(LinearModel(A, np.zeros((2, 1)), C, 1.0, 0.0), 5, x0=np.zeros(2), P0=np.zeros((2, 2)))
    parts = {"A": A.tolist(), "C": C.tolist(), "Bw": 1.0, "Bv": [[1.0, 0.0], [0.0, 0.0]], "Dv": [[0.0, 1.0]]}
    model = uncertain_model(5, **parts, W=1.0, V=1.0)
    with pytest.raises(DesignError, match="Bv v") as caught:
        design(model, 5, **start, w=(0.0, None))
    assert caught.value.parameter == "w"
    parts = {"A": A.tolist(), "C": C.tolist(), "Bw": 1.0, "Dv": np.linspace(1.0, 2.0, 6)[:, None, None]}
    with pytest.raises(DesignError, match="depends on k") as caught:
        design(uncertain_model(5, **parts, W=1.0, V=1.0, vbar=1.0), 5, **start, v=(0.0, None))
    assert caught.value.parameter == "v"
    y, u = np.ones((1, 6, 1)), np.zeros((1, 6, model.nu))
    expected = x_hat(kalman.design(model, 5, **start), y, u)
    np.testing.assert_allclose(x_hat(design(model, 5, **start), y, u), expected, **KALMAN)
