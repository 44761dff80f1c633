"""Plants given by a differential equation: against closed forms and another integrator, alone and in blocks."""

import itertools
import math

import numpy as np
import pytest
from conftest import ROUND
from plants import tanks
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from rmpc_bench.plants.ode import design
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.types import DesignError, Parameters, Status

A, B = np.array([[0.0, 1.0], [-2.0, -0.3]]), np.array([[0.0], [1.0]])
TS = 0.1
BOUNDS = {"h1": (1e-4, 0.6), "h2": (1e-4, 0.6), "pump": (0.0, 30.0)}


def oscillator(x, u, p):
    """A linear oscillator, by products of matrices."""
    return A @ x + p.k * (B @ u)


def linear(**keys):
    """Return the oscillator as a plant."""
    return design(TS, 20, ode=oscillator, states=["a", "b"], inputs=["f"], parameters={"k": 1.0}, **keys)


def two_tanks(**keys):
    """Return the tanks as a plant that starts at a steady state."""
    every = {"ode": tanks.rhs, "output": tanks.output, "states": tanks.STATES, "inputs": tanks.INPUTS,
             "outputs": tanks.OUTPUTS, "parameters": tanks.PARAMETERS, "bounds": BOUNDS,
             "x0": tanks.steady_state(8.0, tanks.PARAMETERS)}  # fmt: skip
    return design(5.0, 20, **{**every, **keys})


def one_state(rhs, **keys):
    """Return a plant of one state and one input."""
    return design(TS, 20, ode=rhs, **{"states": ["a"], "inputs": ["f"], "x0": 0.5, **keys})


def drawn(plant, n_runs, **values):
    """Record of a plant with nominal parameters, or with given ones."""
    every = {name: np.full(n_runs, value) for name, value in plant.nominal.items()}
    return plant.draw({**every, **values}, [np.random.default_rng(i) for i in range(n_runs)], 20)


def moved(plant, x, u, k=0, **values):
    """States and statuses after a sample without noise."""
    return plant.step(k, drawn(plant, len(x), **values), x, u, np.zeros_like(x))


def test_a_linear_equation_has_its_exponential(rng):
    """Oracle: the matrix exponential; the error of Runge-Kutta falls with the fourth power of the step."""
    x, u = rng.standard_normal((9, 2)), rng.standard_normal((9, 1))
    M = expm(np.block([[A, B], [np.zeros((1, 3))]]) * TS)
    exact = x @ M[:2, :2].T + u @ M[:2, 2:].T
    errors = [np.abs(moved(linear(solver=Solver(substeps=n)), x, u).x - exact).max() for n in (1, 2, 4)]
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    # Of the leading term; the next one is smaller by the step, 0.1.
    assert (np.abs(order - 4.0) < 0.1).all()
    # 1e-7 of the range, of one interval.
    assert np.abs(moved(linear(), x, u).x - exact).max() < 1e-6 * np.abs(exact).max()


@pytest.mark.parametrize("method", ["rk4", "LSODA", "RK45", "DOP853", "Radau", "BDF"])
def test_two_tanks_agree_with_another_integrator(rng, method):
    """Oracle: DOP853 of scipy at its tightest tolerance; the tolerance of the test is that of the plant."""
    plant = two_tanks(solver=Solver(method))
    x, u = rng.uniform(0.05, 0.5, (3, 2)), rng.uniform(0.0, 30.0, (3, 1))
    a1 = tanks.PARAMETERS["a1"] * np.array([0.9, 1.0, 1.1])
    found = moved(plant, x, u, a1=a1)
    for i in range(3):
        p = Parameters({**tanks.PARAMETERS, "a1": a1[i]})
        exact = solve_ivp(lambda t, z: tanks.rhs(z, u[i], p), (0.0, 5.0), x[i], "DOP853", rtol=1e-13, atol=1e-15)  # noqa: B023
        # The step errors of the implicit methods add up over the sample.
        np.testing.assert_allclose(found.x[i], exact.y[:, -1], rtol=1e-6 if method in ("Radau", "BDF") else 1e-7)
    assert found.status.tolist() == [0, 0, 0]


def test_a_pendulum_without_friction_keeps_its_energy():
    """Oracle: the energy, over 200 samples."""
    plant = design(0.05, 200, ode=lambda x, u, p: [x[1], -9.81 * np.sin(x[0])], states=["angle", "rate"], x0=[1.0, 0.0])
    x = np.array([[1.0, 0.0]])
    energy = 0.5 * x[0, 1] ** 2 - 9.81 * np.cos(x[0, 0])
    for k in range(200):
        x = moved(plant, x, np.zeros((1, 0)), k).x
    # 200 samples of two intervals with 1e-7 of the range each, at most.
    assert abs(0.5 * x[0, 1] ** 2 - 9.81 * np.cos(x[0, 0]) - energy) < 400 * 1e-7 * 10.0


def test_the_steady_state_of_two_tanks_stays():
    """Oracle: the closed form of the levels."""
    plant, x = two_tanks(), np.array([tanks.steady_state(8.0, tanks.PARAMETERS)])
    found = moved(plant, x, np.full((1, 1), 8.0))
    np.testing.assert_allclose(found.x, x, **ROUND)
    np.testing.assert_array_equal(plant.output(0, drawn(plant, 1), x, np.zeros((1, 1))), x[:, 1:])
    assert (plant.y_unit, plant.u_unit, plant.units["x.1"]) == ("m", "ml/s", "m")


def branches(x, u, p):
    """A right-hand side with a branch, which no block can have."""
    return [u[0] - math.sin(x[0]) if x[0] > 0 else u[0] - x[0]]


def sums(x, u, p):
    """A sum that is over the states of one run, and over all runs in a block."""
    return -0.1 * x * np.sum(x) + u


def in_place(x, u, p):
    """Write into a list of numbers and into the arguments."""
    x[0] = max(x[0], -1.0)
    u[0] += 0.5
    slopes = np.zeros(1)
    slopes[0] = u[0] - x[0]
    return slopes


def long_sum(x, u, p):
    """Sums over many terms, which NumPy adds up in another order for a single run."""
    powers = np.stack([x[0] ** n / (n + 1) for n in range(12)])
    return [u[0] - 0.1 * powers.sum(axis=0)]


@pytest.mark.parametrize(
    ("rhs", "in_blocks"),
    [(branches, False), (sums, False), (in_place, False), (long_sum, True),
     (lambda x, u, p: [np.where(x[0] > 0, u[0] - np.sin(x[0]), u[0] - x[0] - x[0] ** 3)], True)],
    ids=["branches", "sums", "in place", "long sum", "where"],
)  # fmt: skip
@pytest.mark.parametrize("method", ["rk4", "RK45"])
def test_a_run_alone_has_the_same_bits_as_in_any_block(rng, rhs, in_blocks, method):
    """Oracle: the block of 50; what cannot be called for a block is called run by run, and says so."""
    plant = one_state(rhs, solver=Solver(method))
    assert plant.ode.rhs_takes_blocks == in_blocks
    assert any("is called run by run" in each for each in plant.remarks) != in_blocks
    x, u = rng.standard_normal((50, 1)), rng.standard_normal((50, 1))
    whole = moved(plant, x, u)
    for n_runs in (1, 2, 7, 8, 13):
        part = slice(50 - n_runs, 50)
        found = moved(plant, x[part], u[part])
        np.testing.assert_array_equal(found.x, whole.x[part])
        np.testing.assert_array_equal(found.status, whole.status[part])


@pytest.mark.parametrize("n_runs", [1, 2, 7, 8, 13, 50])
def test_a_product_of_matrices_has_the_same_bits_in_any_block(rng, n_runs):
    """Oracle: the block of 50; BLAS adds up a single column in another order than several."""
    plant = linear(solver=Solver(substeps=5))
    assert plant.ode.rhs_takes_blocks
    x, u, w = rng.standard_normal((50, 2)), rng.standard_normal((50, 1)), rng.standard_normal((50, 2))
    whole = plant.step(3, drawn(plant, 50), x, u, w).x
    part = slice(50 - n_runs, 50)
    found = plant.step(3, drawn(plant, n_runs), x[part], u[part], w[part]).x
    np.testing.assert_array_equal(found, whole[part])


def test_a_function_may_use_its_memory_again(rng):
    """Oracle: the same function with new memory in every call; kept references would mix the stages."""
    buffer = np.zeros((2, 8))

    def reusing(x, u, p):
        buffer[...] = A @ x + B @ u
        return buffer

    x, u = rng.standard_normal((8, 2)), rng.standard_normal((8, 1))
    keys = {"states": 2, "inputs": 1, "solver": Solver(substeps=3)}
    found = design(TS, 20, ode=lambda x, u, p: reusing(x, u, p) if x.shape[-1] == 8 else A @ x + B @ u, **keys)
    expected = design(TS, 20, ode=lambda x, u, p: A @ x + B @ u, **keys)
    np.testing.assert_array_equal(moved(found, x, u).x, moved(expected, x, u).x)


def test_a_block_writes_neither_into_arguments_nor_into_parameters(rng):
    """Oracle: the arguments before; a parameter cannot be written at all."""

    def writing(x, u, p):
        x *= 2.0
        u += 1.0
        return -x + u

    x, u = rng.standard_normal((9, 1)), rng.standard_normal((9, 1))
    kept = x.copy(), u.copy()
    found = moved(one_state(writing), x, u)
    np.testing.assert_array_equal(x, kept[0])
    np.testing.assert_array_equal(u, kept[1])
    np.testing.assert_array_equal(found.x, moved(one_state(lambda x, u, p: -(x * 2.0) + (u + 1.0)), x, u).x)

    def changing(x, u, p):
        p.k[...] = 3.0
        return -x

    with pytest.raises(DesignError, match="does not support item assignment|read-only"):
        one_state(changing, parameters={"k": 1.0})


@pytest.mark.parametrize("method", ["rk4", "RK45"])
def test_the_time_at_the_samples_is_exact(method):
    """Oracle: k Ts, without the rounding of a sum; a billionth of the sample is left out at its ends."""
    times = []

    def timed(t, x, u, p):
        times.append(t)
        return [math.cos(t)]

    plant = one_state(timed, solver=Solver(method))
    for k in (0, 3, 7, 1234567):
        times.clear()
        found = moved(plant, np.zeros((1, 1)), np.zeros((1, 1)), k)
        assert k * TS < times[0] <= (k + 2e-9) * TS and (k + 1 - 2e-9) * TS <= max(times) < (k + 1) * TS
        exact = math.sin((k + 1) * TS) - math.sin(k * TS)
        # The time has 1e-11 s of rounding after a million samples.
        assert found.x[0, 0] == pytest.approx(exact, abs=1e-9)


def test_parameters_have_names_in_two_ways():
    """Oracle: the numbers given; a wrong name is said with the nearest."""
    p = Parameters({"a1": 0.5, "items": 2.0})
    assert (p.a1, p["a1"], p.items, [*p], dict(**p)) == (0.5, 0.5, 2.0, ["a1", "items"], {"a1": 0.5, "items": 2.0})
    for wrong in (lambda: p.a2, lambda: p["a2"]):
        with pytest.raises((AttributeError, KeyError), match="'a2' is not a known parameter; did you mean 'a1'"):
            wrong()
    with pytest.raises(AttributeError, match="cannot be changed"):
        p.a1 = 1.0


def test_a_parameter_that_is_no_number_fails_its_run_only(rng):
    """Oracle: status `out-of-range` for that run; the others have their bits."""
    plant, x, u = two_tanks(), rng.uniform(0.1, 0.5, (3, 2)), np.full((3, 1), 8.0)
    a1 = tanks.PARAMETERS["a1"] * np.array([1.0, np.nan, 1.1])
    found, expected = moved(plant, x, u, a1=a1), moved(plant, x, u, a1=np.nan_to_num(a1, nan=7.1e-6))
    assert found.status.tolist() == [Status.OK, Status.OUT_OF_RANGE, Status.OK]
    np.testing.assert_array_equal(found.x, expected.x)


def pendulum_on_cart(x, u, p):
    """Time derivatives of s, s', angle, rate."""
    den = p.M + p.m * np.sin(x[2]) ** 2
    push = u[0] + p.m * np.sin(x[2]) * (p.l * x[3] ** 2 - 9.81 * np.cos(x[2]))
    turn = (9.81 * np.sin(x[2]) - np.cos(x[2]) * push / den) / p.l
    return [x[1], push / den, x[3], turn]


def test_a_given_number_of_substeps_that_is_too_small_is_said():
    """Oracle: the same equation with error control, or with many substeps, has no such remark."""
    few, many, controlled = (
        one_state(lambda x, u, p: [u[0] - 20.0 * x[0]], solver=each)
        for each in (Solver(substeps=1), Solver(substeps=100), Solver())
    )
    assert few.stepping.substeps == 1
    assert any(each.startswith("with 1 substep of rk4 a is off by") for each in few.remarks)
    assert not any("substep" in each for each in (*many.remarks, *controlled.remarks))


CALLS = itertools.count()


@pytest.mark.parametrize(
    ("keys", "key", "message"),
    [
        ({"output": lambda t, x, u, p: [x[0]]}, "output", "must take (x, p) or (x, u, p); it takes (t, x, u, p)"),
        ({"output": lambda t, x, p: [x[0]]}, "output", "must take (x, p) or (x, u, p); it takes (t, x, p)"),
        ({"output": lambda x, u: [x[0]]}, "output", "must take (x, p) or (x, u, p); it takes (x, u)"),
        ({"output": lambda x, p=None: [x[0]]}, "output", "must take (x, p) or (x, u, p); it takes (x, p=..)"),
        ({"ode": lambda x: [x[0]]}, "ode", "must take (x, u, p) or (t, x, u, p); it takes (x)"),
        ({"ode": 3.0}, "ode", "must be a function (got an object of type float)"),
        ({"ode": lambda x, u, p: [x[0]]}, "ode", "rhs returned 1 number; states: 2 (h1, h2)"),
        ({"ode": lambda x, u, p: [x[0], p.k / 0 if x[0] < 9 else 1]}, "ode", "test_ode.py:"),
        ({"ode": lambda x, u, p: [np.log(-x[0]), x[1]]}, "ode", "which are not all finite"),
        ({"ode": lambda x, u, p: [x[0], p.a3]}, "ode", "'a3' is not a known parameter; did you mean 'a2'"),
        ({"ode": lambda x, u, p: None}, "ode", "rhs returned None: it must return 2 states (h1, h2)"),
        ({"ode": lambda x, u, p: [x[0] + next(CALLS), x[1]]}, "ode", "other numbers for the same arguments"),
        ({"output": lambda x, p: [x[0], x[1], x[0]]}, "output", "output returned 3 numbers; outputs: 1 (level)"),
        ({"outputs": None}, "outputs", "name the outputs, or give their number"),
        ({"output": None}, "outputs", "without `output` all states are measured"),
        ({"states": ["h1", "h1"]}, "states", "'h1' is given twice"),
        ({"states": ["h 1", "h2"]}, "states", "'h 1' is no name"),
        ({"states": 0}, "states", "must be at least 1 (got 0)"),
        ({"inputs": ["h2"]}, "inputs", "'h2' is the name of a state, too"),
        ({"parameters": {"a 1": 2.0}}, "parameters", "'a 1' is no name"),
        ({"events": lambda x, u, p: x[0]}, "events", "must have either the attribute `word`"),
        ({"events": 3.0}, "events", "must be a function"),
    ],
)  # fmt: skip
def test_a_mistake_names_its_key(keys, key, message):
    """Oracle: the key and the way out."""
    with pytest.raises(DesignError) as caught:
        two_tanks(**keys)
    assert caught.value.parameter == key
    assert message in str(caught.value)


def test_a_method_refuses_the_keys_of_others():
    """Oracle: substeps belong to rk4 and an absolute tolerance to the others; equal steps control no error."""
    for keys in ({"method": "rk4", "atol": 1e-6}, {"method": "LSODA", "substeps": 3}):
        with pytest.raises(ValueError, match="has no"):
            Solver(**keys)
    with pytest.raises(ValueError, match="rtol has no effect beside substeps"):
        Solver(rtol=1e-6, substeps=3)
