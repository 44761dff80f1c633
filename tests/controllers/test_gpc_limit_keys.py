"""Limits of gpc: statuses of a step and their fallbacks, clipping, and keys that are refused."""

from dataclasses import replace

import numpy as np
import pytest
from controllers.gpc_limit_cases import HARD, KEYS, KINDS, NP, SOFT, models, step

from rmpc_bench.controllers.gpc import design
from rmpc_bench.controllers.limits import Limits
from rmpc_bench.numerics.qp import QuadraticProgram
from rmpc_bench.types import DesignError, OptimisedStep, Status


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("fallback", [None, "clip", "hold", "stop"])
def test_every_status_and_its_fallback(name, fallback, rng):
    """Oracle: no inputs satisfy the limits if u(k-1) is further outside than an increment; NaN is not solved."""
    model = models(rng)[name]
    limits = Limits(u=(-1.0, 1.0), du=(-0.4, 0.4), enforce="qp", fallback=fallback)
    controller = design(model, 3, **KEYS, limits=limits, soft=SOFT)
    x_hat = np.vstack([np.zeros((3, 3)), [[np.nan, 0.0, 0.0]], [[0.0, 9.0, 0.0]]])
    before = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, -1.5], [0.0, 0.0], [0.0, 0.0]])
    r, free = np.zeros((NP + 1, 2)), step(design(model, 3, **KEYS), x_hat, np.zeros((NP + 1, 2)), before).u
    command = step(controller, x_hat, r, before)
    codes = [OptimisedStep(int(code)) for code in command.info["qp"]]
    infeasible, missing = OptimisedStep.INFEASIBLE, OptimisedStep.NOT_CONVERGED
    assert codes[1:4] == [infeasible, infeasible, missing] and codes[4] is OptimisedStep.SOFTENED
    expected = np.clip(np.clip(free, before - 0.4, before + 0.4), -1.0, 1.0)
    # A missing estimate gives no input, not the previous one.
    expected = np.where(np.isnan(expected), expected, before) if fallback == "hold" else expected
    np.testing.assert_array_equal(command.u[1:4], expected[1:4])
    ended, held = (
        np.zeros(5),
        np.array([Status.OK, Status.INFEASIBLE, Status.INFEASIBLE, Status.NOT_CONVERGED, Status.OK]),
    )
    if fallback == "stop":
        ended, held = held, None
    np.testing.assert_array_equal(command.status, ended)
    assert command.step_status is held or np.array_equal(command.step_status, held)


def test_a_solver_that_uses_up_its_iterations_is_not_converged(monkeypatch, rng):
    """Oracle: the limit of the solver, set to one iteration."""
    from rmpc_bench.controllers import constrained

    monkeypatch.setattr(constrained, "QuadraticProgram", lambda *given: QuadraticProgram(*given[:-1], 1))
    controller = design(models(rng)["state"], **KEYS, limits=HARD)
    codes = step(controller, rng.standard_normal((9, 3)), 9.0 * np.ones((NP + 1, 2)), np.zeros((9, 2))).info["qp"]
    assert OptimisedStep.NOT_CONVERGED in codes


def test_clipping_cuts_the_increment_first(rng):
    """The naive order, the input first, leaves the limits of the increment behind the wrong bound."""
    m = models(rng)["constant"]
    limits = Limits(u=(-1.0, 1.0), du=(-0.2, 0.3))
    x_hat, r, before = 9.0 * rng.standard_normal((40, 3)), np.zeros((NP + 1, 2)), rng.uniform(-1.3, 1.3, (40, 2))
    free = step(design(m, **KEYS), x_hat, r, before).u
    command = step(design(m, **KEYS, limits=limits), x_hat, r, before)
    expected = np.clip(before + np.clip(free - before, -0.2, 0.3), -1.0, 1.0)
    naive = before + np.clip(np.clip(free, -1.0, 1.0) - before, -0.2, 0.3)
    np.testing.assert_allclose(command.u, expected, rtol=0.0, atol=1e-15)
    assert (np.abs(command.u) <= 1.0).all() and (np.abs(naive) > 1.0).any()
    assert "qp" not in command.info and command.step_status is None


def test_limits_hold_to_the_last_bit(rng):
    """Oracle: comparison without a tolerance; the solver satisfies them to 1e-10 only."""
    for name in KINDS:
        controller = design(models(rng)[name], 3, **KEYS, limits=HARD)
        before = np.clip(rng.standard_normal((50, 2)), [-0.6, -1.0], [0.8, 0.5])
        u = step(controller, 3.0 * rng.standard_normal((50, 3)), np.ones((NP + 1, 2)), before).u
        assert (u >= [-0.6, -1.0]).all() and (u <= [0.8, 0.5]).all()
        assert (u >= before - 0.5).all() and (u <= before + 0.6).all()


@pytest.mark.parametrize(
    ("changes", "parameter", "message"),
    [
        ({"limits": Limits(u=(1.0, -1.0))}, "limits.u", "must be below"),
        ({"limits": Limits(u=[(0.0, 1.0)] * 3)}, "limits.u", "has 3 pairs, and 2 are required"),
        ({"limits": Limits(du=(1.0, -1.0))}, "limits.du", "must be below"),
        ({"limits": Limits()}, "limits", "no limit to enforce"),
        ({"limits": Limits(u=(-1.0, 1.0), fallback="hold")}, "limits.fallback", "no effect"),
        ({"soft": SOFT}, "soft", "enforce: qp"),
        ({"soft": SOFT, "limits": Limits(u=(-1.0, 1.0))}, "soft", "enforce: qp"),
        ({"soft": {"y.2": SOFT["x.1"]}, "limits": Limits(enforce="qp")}, 'soft."y.2"', "y"),
        ({"soft": {"torque": SOFT["x.1"]}, "limits": Limits(enforce="qp")}, "soft.torque", "torque"),
        (
            {"soft": {"x.1": replace(SOFT["x.1"], steps=6)}, "limits": Limits(enforce="qp")},
            'soft."x.1".steps',
            "horizon",
        ),
    ],
)
@pytest.mark.parametrize("name", KINDS)
def test_bad_limits_are_design_errors_that_name_them(name, changes, parameter, message, rng):
    """Oracle: DesignError.parameter leads to the line of the YAML."""
    with pytest.raises(DesignError, match=message) as caught:
        design(models(rng)[name], 3, **{**KEYS, **changes})
    assert caught.value.parameter == parameter
