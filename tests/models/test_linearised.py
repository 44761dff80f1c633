"""Linear models of the plant: closed forms, sampling, operating points, and what is refused."""

import numpy as np
import pytest
from conftest import ROUND
from models import pendulum
from plants import tanks
from scipy.signal import cont2discrete

from rmpc_bench.models.linearised import design
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.nonlinear import design_ode as ode_model
from rmpc_bench.models.operating_point import At
from rmpc_bench.numerics.linalg import discretise
from rmpc_bench.plants.linear import design as linear_plant
from rmpc_bench.plants.ode import design as ode_plant
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.plants.servo import design as servo_plant
from rmpc_bench.plants.servo import design_linear as servo_linear_plant
from rmpc_bench.types import DesignError

TS = 0.5
NOISE = DesignNoise(process=4e-6, measurement=4e-6)
STEPS = Solver(substeps=10)
DIFFERENCES = {"rtol": 1e-9, "atol": 1e-11}
"""Of a central difference with one Richardson step."""


def two_tanks(**keys):
    """Return the tanks as a plant."""
    given = {"bounds": {"h1": [0.0, 2.0], "h2": [0.0, 2.0], "pump": [0.0, 30.0]}, **keys}
    names = {"states": tanks.STATES, "inputs": tanks.INPUTS, "outputs": tanks.OUTPUTS}
    given |= {"x0": [0.2, 0.1]}
    return ode_plant(TS, 20, ode=tanks.rhs, output=tanks.output, parameters=tanks.PARAMETERS, **names, **given)


def cart():
    """Return the pendulum as a plant."""
    names = {"states": pendulum.STATES, "inputs": pendulum.INPUTS, "outputs": ["s"]}
    given = {"parameters": pendulum.PARAMETERS, "solver": STEPS, **names}
    return ode_plant(TS, 20, ode=pendulum.rhs, output=pendulum.position, **given)


def tank_matrices(x):
    """A and B in closed form."""
    flow = [
        tanks.PARAMETERS[name] / tanks.S1 * np.sqrt(tanks.G / (2 * h)) for name, h in zip(("a1", "a2"), x, strict=True)
    ]
    return np.array([[-flow[0], 0.0], [flow[0], -flow[1]]]), np.array([[1e-6 / tanks.S1], [0.0]])


@pytest.mark.parametrize("at", [At(u=8.0, guess=0.1), At(u={"pump": 8.0}, guess={"h2": 1.5}), At(u=[8.0])])
def test_two_tanks(at):
    """Oracle: the steady state and the Jacobian in closed form, sampled by scipy.signal."""
    model = design(TS, two_tanks(), at=at, noise=NOISE)
    x = tanks.steady_state(8.0, tanks.PARAMETERS)
    np.testing.assert_allclose(model.x_op, x, rtol=1e-11)
    np.testing.assert_allclose(model.y_op, x[1:], rtol=1e-11)
    A, B = tank_matrices(x)
    A, B, *_ = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), TS)
    np.testing.assert_allclose(model.A, A, **DIFFERENCES)
    np.testing.assert_allclose(model.B, B, **DIFFERENCES)
    np.testing.assert_allclose(model.C, [[0.0, 1.0]], **DIFFERENCES)
    np.testing.assert_allclose(model.f0, x - A @ x - B @ [8.0], rtol=1e-7)
    np.testing.assert_array_equal(model.Q_w, 4e-6 * np.eye(2))
    assert not model.deviation.f0.any()


def test_the_input_of_an_output_is_computed():
    """Oracle: u = a2 sqrt(2 g h2) / k."""
    model = design(TS, two_tanks(), at=At(y=0.1, guess={"h1": 0.3, "pump": 2.0}), noise=NOISE)
    u = tanks.PARAMETERS["a2"] * np.sqrt(2 * tanks.G * 0.1) / 1e-6
    np.testing.assert_allclose(model.u_op, u, rtol=1e-10)
    np.testing.assert_allclose(model.x_op, tanks.steady_state(u, tanks.PARAMETERS), rtol=1e-10)


@pytest.mark.parametrize("upright", [True, False])
def test_a_pendulum_on_a_cart(upright):
    """Oracle: the linearisation in closed form; A is singular, and the position keeps its guess."""
    guess = {"s": 0.7, "a": 0.3 if upright else 3.0}
    model = design(TS, cart(), at=At(u=0.0, guess=guess), noise=NOISE)
    np.testing.assert_allclose(model.x_op, [0.7, 0.0 if upright else np.pi, 0.0, 0.0], atol=1e-10)
    A, B = discretise(*pendulum.linear(pendulum.PARAMETERS, upright=upright), TS)
    np.testing.assert_allclose(model.A, A, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(model.B, B, rtol=1e-7, atol=1e-8)
    facts = dict(model.facts())
    assert facts["observable"] == facts["controllable"] == "4 of 4 states"


def test_a_point_that_is_no_steady_state_has_a_drift():
    """Oracle: the closed form of x' = f + A dx with the input held, at dx = 0."""
    x, u = np.array([0.2, 0.1]), np.array([3.0])
    model = design(TS, two_tanks(), at=At(x={"h1": 0.2, "h2": 0.1}, u=3.0), noise=NOISE)
    A, _ = tank_matrices(x)
    p = two_tanks().ode.p
    drift = np.linalg.solve(A, (discretise(A, np.eye(2), TS)[0] - np.eye(2)) @ np.array(tanks.rhs(x, u, p)))
    np.testing.assert_allclose(model.A @ x + model.B @ u + model.f0 - x, drift, rtol=1e-8)
    np.testing.assert_allclose(model.deviation.f0, drift, rtol=1e-8)


def oscillator(x, u, p):
    """A linear equation with a constant part and a singular matrix."""
    return [x[1], u[0] - 0.3 * x[1] + 0.2]


def oscillating():
    """Return the linear equation as a plant."""
    return ode_plant(TS, 20, ode=oscillator, states=["a", "b"], inputs=["f"])


def test_a_linear_equation_is_its_own_model():
    """Oracle: the exponential of the block matrix, at any point; the constant part included."""
    plant = oscillating()
    A, B = discretise(np.array([[0.0, 1.0], [0.0, -0.3]]), np.array([[0.0, 0.0], [1.0, 0.2]]), TS)
    for at in (At(x=[1.0, -2.0], u=0.5), At(u=-0.2, guess=3.0), At(x=0.0, u=0.0)):
        model = design(TS, plant, at=at, noise=NOISE)
        np.testing.assert_allclose(model.A, A, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(model.B, B[:, :1], rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(model.f0, B[:, 1], rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(model.d0, 0.0, atol=1e-10)


def test_built_in_linear_plants_are_their_own_models(rng):
    """Oracle: their matrices."""
    A, B, C = 0.3 * rng.standard_normal((3, 3)), rng.standard_normal((3, 2)), rng.standard_normal((2, 3))
    model = design(TS, linear_plant(TS, 5, A=A.tolist(), B=B.tolist(), C=C.tolist()), at=At(u=[1.0, 2.0]), noise=NOISE)
    for name, matrix in (("A", A), ("B", B), ("C", C)):
        np.testing.assert_allclose(getattr(model, name), matrix, **ROUND)
    np.testing.assert_allclose(model.x_op, np.linalg.solve(np.eye(3) - A, B @ [1, 2]), rtol=1e-10)
    np.testing.assert_allclose(model.f0, 0.0, atol=1e-10)
    for plant in (servo_plant(0.1), servo_linear_plant(0.1)):
        linear = plant.linear(dict(plant.nominal))
        model = design(0.1, plant, at=At(u=0.0), noise=NOISE)
        np.testing.assert_allclose(model.A, linear.A, **ROUND)
        np.testing.assert_array_equal(model.x_op, 0.0)


def kinked(**keys):
    """Return a plant with a kink at x = 1."""
    return ode_plant(TS, 20, ode=pendulum.table, states=["level"], inputs=["flow"], solver=STEPS, **keys)


def test_a_kink_at_the_operating_point_is_refused():
    """A central difference would give 2.5, the mean of two slopes that are both wrong."""
    with pytest.raises(DesignError, match=r"has a kink at the operating point \(level\)") as found:
        design(TS, kinked(), at=At(x=1.0, u=0.0), noise=NOISE)
    assert found.value.parameter == "at"
    model = design(TS, kinked(), at=At(x=1.5, u=0.0), noise=NOISE)
    np.testing.assert_allclose(model.A, np.exp(-4.0 * TS), rtol=1e-9)


def test_the_jacobian_of_the_user_replaces_differences():
    """At a kink it is needed; where it differs from differences, a remark says by how much."""
    model = design(TS, kinked(), at=At(x=1.0, u=0.0), noise=NOISE, jacobian=lambda x, u, p: ([[-4.0]], [[1.0]]))
    np.testing.assert_allclose(model.A, np.exp(-4.0 * TS), **ROUND)

    def exact(x, u, p):
        return (*tank_matrices(x), [[0.0, 1.0]])

    model = design(TS, two_tanks(), at=At(u=8.0), noise=NOISE, jacobian=exact)
    assert model.remarks == ()

    def wrong(x, u, p):
        A, B = tank_matrices(x)
        return 1.01 * A, B

    model = design(TS, two_tanks(), at=At(u=8.0), noise=NOISE, jacobian=wrong)
    assert [text.split(" by ")[0] for text in model.remarks] == [
        "A of `jacobian` differs from differences of the functions"
    ]


def empty(x, u, p):
    """A rhs without a steady state."""
    return [1.0 + x[0] ** 2]


def raising(x, u, p):
    """A rhs with a mistake."""
    return [p.missing * x[0]]


# plant, at, words of the message, key
REFUSED = {
    "no point": (two_tanks, At(guess=0.1), "give u, x and u, y", "at"),
    "both": (two_tanks, At(u=8.0, y=0.1), "either y or u", "at.y"),
    "unknown": (two_tanks, At(u={"pum": 8.0}), "'pump'", "at.u"),
    "missing": (two_tanks, At(x={"h1": 0.1}, u=8.0), "no value for h2", "at.x"),
    "count": (two_tanks, At(x=[0.1, 0.2, 0.3], u=8.0), "states: 2 (h1, h2)", "at.x"),
    "outside": (two_tanks, At(u=31.0), "pump = 31 is outside the bounds of the plant, [0, 30]", "at.u"),
    "guess": (two_tanks, At(u=8.0, guess=3.0), "outside the bounds", "at.guess"),
    "no effect": (two_tanks, At(x=0.1, u=8.0, guess=3.0), "no effect", "at.guess"),
    "beyond": (two_tanks, At(u=29.0 + 0.9, guess=1.0), None, None),
    "edge": (two_tanks, At(u=0.0, guess=1.0), "no steady state was found for pump = 0 ml/s", "at"),
    "none": (lambda: ode_plant(TS, 20, ode=empty, states=["a"], solver=STEPS), At(u=0.0), "the residual is", "at"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name):
    """Every message names the key and the way out; the level of an empty tank has no derivative."""
    plant, at, words, key = REFUSED[name]
    if words is None:
        assert design(TS, plant(), at=at, noise=NOISE).x_op.max() < 2.0
        return
    with np.errstate(all="ignore"), pytest.raises(DesignError) as found:
        design(TS, plant(), at=at, noise=NOISE)
    assert words in str(found.value)
    assert found.value.parameter == key


def test_an_error_of_the_function_is_reported():
    """An equation of the model's own is first called at the guess."""
    with pytest.raises(DesignError, match=r"rhs raises AttributeError at a = 0.5, b = 0.5: 'missing'") as found:
        ode_model(TS, oscillating(), ode=raising, noise=NOISE, at=At(u=0.0, guess=0.5))
    assert found.value.parameter == "at.guess"


def test_noise_of_the_wrong_size_is_reported_at_its_key():
    """The covariance of the process noise has an entry per state."""
    with pytest.raises(DesignError) as found:
        design(TS, two_tanks(), at=At(u=8.0), noise=DesignNoise(process=[1.0, 1.0, 1.0], measurement=1.0))
    assert found.value.parameter == "noise.process"


def test_facts_name_states_and_units():
    """Residual, eigenvalues, poles and ranks are those of the operating point."""
    facts = design(TS, two_tanks(), at=At(u=8.0), noise=NOISE).facts()
    assert facts[0] == ("operating point", "h1 = 0.0647089 m, h2 = 0.0821864 m; pump = 8 ml/s; level = 0.0821864 m")
    assert facts[1][1].startswith("steady state with residual ")
    known = dict(facts)
    slow, fast = (float(value) for value in known["eigenvalues"].removesuffix(" 1/s").split(", ")[::-1])
    assert known["sampled poles"] == f"{np.exp(slow * TS):.5g}, {np.exp(fast * TS):.5g}"
