"""CasADi functions of nonlinear design models: the numbers of the model, and errors where there are none."""

import math
import subprocess
import sys

import numpy as np
import pytest
from conftest import ROUND
from plants import tanks

from rmpc_bench.adapters.casadi import output_function, step_function
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.nonlinear import design as nonlinear
from rmpc_bench.models.operating_point import At
from rmpc_bench.plants.linear import design as linear_plant
from rmpc_bench.plants.ode import design as ode_plant
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.types import DesignError

casadi = pytest.importorskip("casadi")
NOISE = DesignNoise(process=1e-6, measurement=4e-6)


def model_of(rhs, states=2, inputs=1, bounds=None, at=None, **keys):
    """Return a nonlinear design model with three substeps."""
    plant = ode_plant(
        2.0, 12, ode=rhs, states=states, inputs=inputs, bounds=bounds, solver=Solver(substeps=3), x0=[0.2, 0.1], **keys
    )
    return nonlinear(2.0, plant, noise=NOISE, at=at)


def of_tanks():
    """Return the model of the two tanks."""
    names = {"states": tanks.STATES, "inputs": tanks.INPUTS, "outputs": tanks.OUTPUTS}
    bounds = {"h1": [1e-3, 2.0], "h2": [1e-3, 2.0], "pump": [0.0, 30.0]}
    return model_of(tanks.rhs, output=tanks.output, parameters=tanks.PARAMETERS, bounds=bounds, **names)


def largest_difference(model, arguments=lambda x, u, k: (x, u)):
    """Return the largest difference of x(k+1) over random numbers, and whether the outputs have the same bits."""
    f, h = step_function(model), output_function(model)
    rng, off = np.random.default_rng(0), []
    for k in range(200):
        x, u = rng.uniform(0.01, 0.6, model.nx), rng.uniform(0.0, 30.0, model.nu)
        off.append(np.abs(np.ravel(f(*arguments(x, u, k)).full()) - model.f(x, u, k)).max())
        np.testing.assert_array_equal(np.ravel(h(x).full()), model.h(x))
    return max(off)


def test_the_step_of_the_tanks_has_the_bits_of_the_model():
    """Oracle: f and h of the model.  Both take the same operations in the same order."""
    assert largest_difference(of_tanks()) == 0.0


def test_arrays_matrices_and_functions_of_numpy_can_be_traced():
    """A rhs that multiplies a matrix, cuts x into parts and uses np.where, np.clip and np.maximum."""

    def rhs(x, u, p):
        position, rate = x[:1], x[1:]
        coupled = np.array([[0.0, 1.0], [-0.5, -0.2]]) @ x
        cut = np.clip(u[0], 0.0, 20.0) + np.maximum(rate[0], 0.0) + np.where(position[0] > 0.2, 0.1, 0.0)
        return coupled + np.array([0.0, 1.0]) * cut

    assert largest_difference(model_of(rhs)) < 1e-12


def test_a_time_dependent_equation_takes_the_sample_as_third_argument():
    """Oracle: f of the model at the same sample."""
    model = model_of(lambda t, x, u, p: [x[1], u[0] * np.cos(t) - x[0]])
    assert step_function(model).n_in() == 3
    assert largest_difference(model, lambda x, u, k: (x, u, k)) < 1e-12


def test_a_plant_with_matrices_is_traced_too():
    """Oracle: f and h of the model, x(k+1) = A x + B u."""
    plant = linear_plant(0.1, 12, A=[[0.9, 0.1], [0.0, 0.8]], B=[[0.0], [1.0]], C=[[1.0, 0.5]])
    model = nonlinear(0.1, plant, noise=NOISE)
    f, h, x, u = step_function(model), output_function(model), np.array([0.3, -2.0]), np.array([1.7])
    np.testing.assert_allclose(np.ravel(f(x, u).full()), model.f(x, u), **ROUND)
    np.testing.assert_allclose(np.ravel(h(x).full()), model.h(x), **ROUND)


def test_a_branch_is_refused_with_the_way_out():
    """A symbol has no value that `if` could test."""
    model = model_of(lambda x, u, p: [x[0] if x[0] > 0 else 0.0, x[1]])
    with pytest.raises(DesignError, match=r"rhs cannot be called .*Cannot compute the truth value.*np\.where for `if`"):
        step_function(model)


def test_functions_of_math_are_refused_although_casadi_takes_them():
    """Naive form: the trace of math.sin succeeds, and every value of it is NaN."""
    symbol = casadi.SX.sym("x")
    naive = casadi.Function("naive", [symbol], [math.sin(symbol)])
    assert math.isnan(float(naive(0.5)))
    with pytest.raises(DesignError, match=r"gives \[nan, .*np\.sin for math\.sin"):
        step_function(model_of(lambda x, u, p: [math.sin(x[0]), x[1]]))


def test_functions_of_numpy_neither_warn_nor_change_the_global_mode():
    """Naive form: since CasADi 3.8 np.sqrt of a symbol warns, which is an error in this test suite."""
    if not hasattr(casadi.GlobalOptions, "setNumpyMode"):
        pytest.skip("this CasADi has no mode for functions of NumPy")
    with pytest.warns(FutureWarning, match="legacy"):
        np.sqrt(casadi.SX.sym("x"))
    before = casadi.GlobalOptions.getNumpyMode()
    step_function(of_tanks())
    assert casadi.GlobalOptions.getNumpyMode() == before


def test_the_functions_are_compared_at_the_operating_point():
    """An equation that is defined near its operating point only: at other numbers nothing can be compared."""

    def rhs(x, u, p):
        return [np.sqrt(1e-4 - (x[0] - 5.0) ** 2) * math.cos(x[1]), -x[1] + u[0]]

    model = nonlinear(
        0.01,
        ode_plant(0.01, 12, ode=rhs, states=2, inputs=1, solver=Solver(substeps=1), x0=[5.0, 0.0]),
        noise=NOISE,
        at=At(x=[5.0, 0.0], u=0.0),
    )
    with pytest.raises(DesignError, match="gives"):
        step_function(model)


def test_the_module_is_imported_without_casadi():
    """CasADi is imported by the functions and not with the module."""
    code = "import sys, rmpc_bench.adapters.casadi; assert 'casadi' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
