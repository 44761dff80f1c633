"""Extra signals of plants and their states between the samples, against independent integrations."""

import numpy as np
import pytest
from plants.servo_oracle import TABLE_2, flow
from plants.tanks import INPUTS, OUTPUTS, PARAMETERS, STATES, output, rhs
from scipy.integrate import solve_ivp

from rmpc_bench.metrics.limits import Largest, Violation
from rmpc_bench.models.servo import ServoNoise, continuous
from rmpc_bench.models.servo import design as servo_model
from rmpc_bench.plants.moving_slide import design as moving_slide
from rmpc_bench.plants.ode import Solver
from rmpc_bench.plants.ode import design as ode_plant
from rmpc_bench.plants.servo import design as servo
from rmpc_bench.plants.servo import design_linear
from rmpc_bench.types import DesignError, MetricLayout, Record

PARTS = 5


def drawn(plant, n_runs, rng, spread=0.3):
    """Parameters of every run within some range of the nominal ones, as numbers per run, and what `draw` returns."""
    p = {name: value * rng.uniform(1 - spread, 1 + spread, n_runs) for name, value in plant.nominal.items()}
    return [{name: values[i] for name, values in p.items()} for i in range(n_runs)], plant.draw(p, [], 1)


def record_of(plant, delta, x, u):
    """Record of successive periods that begin at the states x, all k but the last."""
    layout = MetricLayout(u.shape[1], plant.Ts, plant.y_unit, plant.u_unit, plant=plant)
    y = np.stack([plant.output(k, delta, x[:, k], np.zeros((len(x), plant.nv))) for k in range(x.shape[1])], axis=1)
    return Record(plant.Ts, x, y, x, u, np.zeros((x.shape[1], plant.ny)), experiment=layout, delta=delta)


@pytest.mark.parametrize("make", [servo, design_linear])
def test_torque_accelerates_the_load(make):
    """Oracle: the equation of the load, J_l th_l'' = shaft_torque - beta_l w_l, of the model and with drawn parameters.

    Trap: the torque of `models/servo.py`'s T_s is that of the motor, rho times smaller.
    """
    rng, plant = np.random.default_rng(3), make(0.1)
    rows, delta = drawn(plant, 4, rng)
    x = rng.standard_normal((4, 6, plant.nx))
    torque = plant.extra_signal("shaft_torque", delta, x)
    for p, states, found in zip(rows, x, torque, strict=True):
        A, _ = continuous(p)
        expected = p["J_l"] * (states[:, :4] @ A[1]) + p["beta_l"] * states[:, 1]
        np.testing.assert_allclose(found, expected, rtol=1e-12)
        back = p["J_m"] * (states[:, :4] @ A[3]) + (p["beta_m"] + p["K_t"] ** 2 / p["R"]) * states[:, 3]
        own = plant.extra_signal("motor_torque", delta, x)[list(rows).index(p)]
        np.testing.assert_allclose(-own, back, rtol=1e-10, atol=1e-10)
    assert plant.extra_signals == {"shaft_torque": "N m", "motor_torque": "N m"}


def test_plant_and_model_name_the_same_signals():
    """Oracle: with nominal parameters the rows of the design model give the signals of the plant."""
    plant, model = design_linear(0.1), servo_model(0.1, noise=ServoNoise(1.0, 1.0))
    delta = plant.draw({name: np.array([value]) for name, value in plant.nominal.items()}, [], 1)
    x = np.random.default_rng(4).standard_normal((1, 7, 4))
    assert set(model.extra_signals) == set(plant.extra_signals)
    for name, Z in model.extra_signals.items():
        np.testing.assert_allclose(plant.extra_signal(name, delta, x), (x @ Z.T)[:, :, 0], rtol=1e-12)


def test_servo_between_samples():
    """Oracle: an event-driven integration by DOP853 with other code, from states at rest, sticking and moving."""
    plant = servo(0.1, **{name: value for name, value in TABLE_2.items()})
    delta = plant.draw({name: np.full(3, value) for name, value in plant.nominal.items()}, [], 1)
    x = np.array([[0.0] * 5, [0.1, -0.4, 1.0, 9.0, 2.0], [0.1, 0.3, 2.5, 0.0, -1.0]])
    u = np.array([[[220.0]], [[-150.0]], [[60.0]]])
    found = plant.between(delta, x[:, None], u, PARTS)
    assert found.shape == (3, 1, PARTS, 5)
    for run in range(3):
        for part in range(PARTS):
            expected = flow(TABLE_2, x[run], u[run, 0, 0], (part + 1) * 0.1 / PARTS)
            np.testing.assert_allclose(found[run, 0, part], expected, rtol=1e-7, atol=1e-8)
    whole = plant.step(0, delta, x, u[:, 0], np.zeros((3, 4))).x
    np.testing.assert_allclose(found[:, 0, -1], whole, rtol=1e-12, atol=1e-12)


def test_linear_servo_between_samples():
    """Oracle: solve_ivp with the drawn parameters of every run."""
    rng, plant = np.random.default_rng(5), design_linear(0.1)
    rows, delta = drawn(plant, 3, rng)
    x, u = rng.standard_normal((3, 2, 4)), rng.uniform(-220.0, 220.0, (3, 2, 1))
    found = plant.between(delta, x, u, PARTS)
    for run, p in enumerate(rows):
        A, B = continuous(p)
        for k in range(2):
            times = np.arange(1, PARTS + 1) * 0.1 / PARTS
            driven = B[:, 0] * u[run, k, 0]
            exact = solve_ivp(lambda t, z: A @ z + driven, (0, 0.1), x[run, k], "DOP853", times, rtol=1e-12, atol=1e-12)  # noqa: B023
            np.testing.assert_allclose(found[run, k], exact.y.T, rtol=1e-9, atol=1e-9)
    ends = np.stack([plant.step(k, delta, x[:, k], u[:, k], np.zeros((3, 4))).x for k in range(2)], axis=1)
    np.testing.assert_allclose(found[:, :, -1], ends, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("solver", [Solver(), Solver("RK45", rtol=1e-10, atol=1e-12)])
@pytest.mark.parametrize("in_blocks", [True, False])
def test_differential_equation_between_samples(solver, in_blocks):
    """Oracle: solve_ivp; the equation depends on the time, so that the sample counts."""

    def driven(t, x, u, p):
        level = x[0] if in_blocks or x[0] > 0.0 else x[0]
        return [x[1], u[0] + np.sin(3.0 * t) - p.k * level]

    plant = ode_plant(
        0.2, 10, ode=driven, states=["s", "v"], inputs=["f"], parameters={"k": 4.0}, solver=solver,
    )  # fmt: skip
    assert plant.ode.rhs_takes_blocks == in_blocks and plant.has_between
    delta = plant.draw({"k": np.array([4.0, 9.0])}, [], 10)
    x, u, first = np.array([[[1.0, 0.0]], [[0.5, -1.0]]]), np.array([[[0.5]], [[7.0]]]), 4
    found = plant.between(delta, x, u, PARTS, first)
    for run, k in enumerate((4.0, 9.0)):
        force, times = u[run, 0, 0], 0.2 * (first + np.arange(1, PARTS + 1) / PARTS)
        exact = solve_ivp(
            lambda t, z: [z[1], force + np.sin(3.0 * t) - k * z[0]],  # noqa: B023
            (0.2 * first, 0.2 * first + 0.2 * (1 + 1e-12)), x[run, 0], "DOP853", times, rtol=1e-12, atol=1e-12,
        )  # fmt: skip
        # rk4 has 1e-7 of the range of a state, which is about 2 here.
        np.testing.assert_allclose(found[run, 0], exact.y.T, rtol=1e-7, atol=2e-7)


def test_robot_between_samples():
    """Oracle: the plant's own step with a shorter sampling time, whose accuracy other tests compare."""
    rng, plant, shorter = np.random.default_rng(6), moving_slide(0.01), moving_slide(0.01 / PARTS)
    nominal = {name: np.full(2, value) for name, value in plant.nominal.items()}
    delta = plant.draw(nominal, [], 1)
    x, u = 0.01 * rng.standard_normal((2, 1, 6)), rng.standard_normal((2, 1, 4))
    found, now = plant.between(delta, x, u, PARTS), x[:, 0]
    for part in range(PARTS):
        now = shorter.step(0, delta, now, u[:, 0], np.zeros((2, 6))).x
        np.testing.assert_array_equal(found[:, 0, part], now)
    np.testing.assert_allclose(now, plant.step(0, delta, x[:, 0], u[:, 0], np.zeros((2, 6))).x, rtol=1e-8, atol=1e-11)


def test_a_map_has_nothing_between_its_samples():
    """Oracle: `discrete: true`."""
    plant = ode_plant(1.0, 4, ode=lambda x, u, p: 0.5 * x, states=["s"], discrete=True)
    issues = [*Largest(of="s", between=2).check(MetricLayout(4, plant=plant))]
    assert [issue.key for issue in issues] == ["between"]


def peak_torque(twist):
    """Plant and record of one run whose shaft swings freely from a twist, over two samples."""
    plant = design_linear(0.1)
    delta = plant.draw({name: np.array([value]) for name, value in plant.nominal.items()}, [], 1)
    x = np.zeros((1, 3, 4))
    x[0, 0] = [-twist, 0.0, 0.0, 20.0]
    for k in range(2):
        x[:, k + 1] = plant.step(k, delta, x[:, k], np.zeros((1, 1)), np.zeros((1, 4))).x
    return plant, record_of(plant, delta, x, np.zeros((1, 2, 1)))


def test_metrics_between_samples():
    """Oracle: solve_ivp on a fine grid; the torque at the samples is smaller than the peak between them."""
    plant, record = peak_torque(0.05)
    A, _ = continuous(plant.nominal)
    times = np.linspace(0.0, 0.2, 401)
    exact = solve_ivp(lambda t, z: A @ z, (0, 0.2), record.x[0, 0], "DOP853", times, rtol=1e-12, atol=1e-12).y
    torque = plant.nominal["k_theta"] * (exact[2] / plant.nominal["rho"] - exact[0])
    of = {"of": "shaft_torque", "to": "N"}
    at_samples, between = Largest(**of).evaluate(record).item(), Largest(**of, between=199).evaluate(record).item()
    assert at_samples == pytest.approx(np.abs(torque[::200]).max(), rel=1e-9)
    assert between == pytest.approx(np.abs(torque).max(), rel=1e-9)
    assert between > 1.002 * at_samples
    limit = 0.9 * np.abs(torque).max()
    beyond = np.maximum(np.abs(torque) - limit, 0.0)
    share = Violation(**of, limit=limit, between=199).evaluate(record).item()
    integral = Violation(**of, limit=limit, between=199, what="integral").evaluate(record).item()
    assert share == pytest.approx(np.mean(beyond > 0.0), abs=1.5 / 401)
    assert integral == pytest.approx(beyond.sum() * 0.0005, rel=1e-6)
    assert Largest(of="y", to="N", between=199).evaluate(record).item() == pytest.approx(
        np.abs(exact[0]).max(), rel=1e-9
    )


def flow_out(x, p):
    """Outflows of the tanks."""
    return [p.a1 * np.sqrt(2 * 9.81 * x[0]), p.a2 * np.sqrt(2 * 9.81 * x[1])]


def tanks(**keys):
    """Return two tanks with their outflows as extra signals."""
    named = {"states": STATES, "inputs": INPUTS, "outputs": OUTPUTS, "parameters": PARAMETERS}
    given = {"extra_signal": flow_out, "extra_signals": {"q1": "m^3/s", "q2": "m^3/s"}, "x0": [0.2, 0.1], **keys}
    return ode_plant(1.0, 5, ode=rhs, output=output, **named, **given)


def test_extra_signals_of_a_differential_equation():
    """Oracle: the function with the parameters of every run, called in blocks and run by run."""

    def one_run(x, p):
        return flow_out(x, p) if x[0] > 0 else [0.0, 0.0]

    delta_of = {"a1": np.array([7e-6, 8e-6]), "a2": np.array([6e-6, 5e-6]), "k": np.ones(2)}
    x = np.random.default_rng(7).uniform(0.1, 0.4, (2, 4, 2))
    expected = {
        name: delta_of[f"a{i + 1}"][:, None] * np.sqrt(2 * 9.81 * x[:, :, i]) for i, name in enumerate(("q1", "q2"))
    }
    for function in (flow_out, one_run):
        plant = tanks(extra_signal=function)
        assert plant.extra.output_takes_blocks == (function is flow_out)
        assert plant.extra_signals == {"q1": "m^3/s", "q2": "m^3/s"}
        assert ("extra signals", "q1 [m^3/s], q2 [m^3/s]") in plant.facts()
        delta = plant.draw(delta_of, [], 5)
        for name, values in expected.items():
            np.testing.assert_allclose(plant.extra_signal(name, delta, x), values, rtol=1e-13)
        single = plant.draw({name: values[:1] for name, values in delta_of.items()}, [], 5)
        np.testing.assert_array_equal(plant.extra_signal("q1", single, x[:1]), plant.extra_signal("q1", delta, x)[:1])


@pytest.mark.parametrize(
    ("keys", "key", "message"),
    [
        ({"extra_signals": None}, "extra_signals", "name the extra signals"),
        ({"extra_signal": None}, "extra_signals", "give `extra_signal`"),
        ({"extra_signals": ["h1", "q2"]}, "extra_signals", "'h1' is the name of another signal"),
        ({"extra_signals": ["P", "q2"]}, "extra_signals", "'P' is the name of another signal"),
        ({"extra_signal": lambda x, u, p: [0.0]}, "extra_signal", r"must take \(x, p\)"),
        ({"extra_signals": ["q1"]}, "extra_signal", "returned 2 numbers"),
    ],
)
def test_wrong_extra_signals(keys, key, message):
    """Oracle: the rules of the keys."""
    with pytest.raises(DesignError, match=message) as found:
        tanks(**keys)
    assert found.value.parameter == key
