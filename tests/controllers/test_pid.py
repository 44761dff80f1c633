"""PID loops against python-control, scipy.signal, closed forms and their limits."""

import numpy as np
import pytest
from conftest import ROUND, random_model
from scipy.signal import lfilter

from rmpc_bench.controllers.limits import InputLimits
from rmpc_bench.controllers.pid import design
from rmpc_bench.diagnostics.stability import linear_pair, spectral_radius
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.linearised import LinearisedModel
from rmpc_bench.numerics.linalg import discretise
from rmpc_bench.types import DesignError, Estimate, LinearPlant, OperatingPoint

TS = 0.1
PID = {"Kp": 2.0, "Ki": 1.5, "Kd": 0.4, "Tf": 0.05}


def model(ny=1, nu=1):
    """Model of which a PID uses the sizes only."""
    return LinearModel([[0.5]], np.ones((1, nu)), np.ones((ny, 1)), 1.0, np.eye(ny))


def commanded(law, y, r, x_hat=None):
    """Inputs over time (steps, nu) and states of the law, for given measurements (steps, ny) of one run."""
    state, inputs, states = law.init(1), [], []
    for k, measured in enumerate(y):
        estimate = Estimate(np.zeros((1, law.nx)) if x_hat is None else x_hat[k][None])
        state, command = law.control(k, state, np.array(measured, dtype=float)[None], estimate, np.atleast_2d(r[k]))
        inputs.append(command.u[0])
        states.append(state)
    return np.array(inputs), states


def test_a_proportional_law_is_the_limit():
    """Oracle: the stated limit, with a weight of the reference."""
    y, r = np.random.default_rng(1).standard_normal((2, 20, 1))
    u, _ = commanded(design(model(), TS, Kp=3.0, b=0.4), y, r)
    np.testing.assert_allclose(u, 3.0 * (0.4 * r - y), **ROUND)


@pytest.mark.parametrize("Tf", [0.0, 0.05, 5.0])
def test_each_part_is_a_digital_filter(Tf):
    """Oracle: scipy.signal.lfilter of the backward Euler transfer functions; all signals are 0 at k = 0."""
    y, r = np.random.default_rng(2).standard_normal((2, 60, 1))
    y[0] = r[0] = 0.0
    keys = {**PID, "Tf": Tf, "b": 0.7, "c": 0.3}
    u, _ = commanded(design(model(), TS, **keys), y, r)
    summed = lfilter([1.5 * TS, 0.0], [1.0, -1.0], (r - y)[:, 0])
    derived = lfilter([0.4, -0.4], [Tf + TS, -Tf], (0.3 * r - y)[:, 0])
    np.testing.assert_allclose(u[:, 0], 2.0 * (0.7 * r - y)[:, 0] + summed + derived, rtol=1e-10, atol=1e-12)


def test_a_ramp_has_a_closed_form():
    """Oracle: sums of a geometric and an arithmetic series."""
    k, slope = np.arange(50), 0.3
    y = slope * TS * k[:, None]
    law = design(model(), TS, Kp=0.0, Ki=1.5, Kd=0.4, Tf=0.2)
    _, states = commanded(law, y, np.zeros_like(y))
    integral, derivative = (np.array([getattr(each, name)[0, 0] for each in states]) for name in law_parts())
    np.testing.assert_allclose(integral, -1.5 * slope * TS**2 * k * (k + 1) / 2, rtol=1e-12)
    np.testing.assert_allclose(derivative, -0.4 * slope * (1.0 - (0.2 / 0.3) ** k), rtol=1e-11)


def law_parts():
    """Names of the parts with a memory."""
    return ("integral", "derivative")


def test_closed_loop_of_python_control():
    """Oracle: python-control's closed loop of the same discrete transfer functions, with a step at k = 1."""
    control = pytest.importorskip("control")
    A, B = discretise(np.array([[0.0, 1.0], [-4.0, -1.0]]), np.array([[0.0], [1.0]]), TS)
    C = np.array([[1.0, 0.0]])
    keys = {"Kp": 2.0, "Ki": 3.0, "Kd": 0.5, "Tf": 0.15}
    # Kp, Ki Ts z / (z - 1) and Kd (z - 1) / ((Tf + Ts) z - Tf), with one column for r and one for y.
    proportional = control.ss([], [], [], [[2.0 * 0.6, -2.0]], TS)
    summed = control.ss([[1.0]], [[1.0, -1.0]], [[3.0 * TS]], [[3.0 * TS, -3.0 * TS]], TS)
    pole, gain = 0.15 / (0.15 + TS), 0.5 / (0.15 + TS)
    e = np.array([[0.2, -1.0]])
    derived = control.ss([[pole]], e, [[gain * (pole - 1.0)]], gain * e, TS)
    opened = control.ss(A, B, C, 0.0, TS) * (proportional + summed + derived)
    n = 80
    r = np.ones((n, 1))
    r[0] = 0.0
    closed = control.feedback(opened, control.ss([], [], [], [[0.0], [1.0]], TS), sign=1)
    _, expected = control.forced_response(closed, TS * np.arange(n), np.hstack([r, 0.0 * r]).T)
    law, x, found = design(model(), TS, **keys, b=0.6, c=0.2), np.zeros((1, 2)), []
    state = law.init(1)
    for k in range(n):
        y = x @ C.T
        found.append(y[0, 0])
        state, command = law.control(k, state, y, Estimate(np.zeros((1, 1))), r[k : k + 1])
        x = x @ A.T + command.u @ B.T
    np.testing.assert_allclose(found, expected[0], rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("Tf", [0.0, 1e-6, 1e-3, 1.0, 1e3])
def test_the_filter_of_the_derivative_does_not_ring(Tf):
    """The response to a step of y keeps its sign and decays, for any Tf; Tustin's rule rings for a small Tf."""
    law = design(model(), TS, Kp=0.0, Kd=1.0, Tf=Tf)
    y = np.ones((30, 1))
    y[0] = 0.0
    u = commanded(law, y, np.zeros_like(y))[0][1:, 0]
    assert (u <= 0.0).all()
    assert (np.diff(u) >= 0.0).all()
    if Tf == 1e-3:
        tustin = lfilter([2.0, -2.0], [2.0 * Tf + TS, TS - 2.0 * Tf], -y[:, 0])[1:]
        assert (tustin[:8:2] < 0.0).all()
        assert (tustin[1:8:2] > 0.0).all()


def test_the_weight_of_the_reference_avoids_a_derivative_kick():
    """A step of the reference at k = 1: the jump is Kp b, and with c = 1 Kd / (Tf + Ts) more."""
    r = np.ones((3, 1))
    r[0] = 0.0
    y = np.zeros_like(r)
    calm, kicked = (commanded(design(model(), TS, Kp=2.0, Kd=0.4, Tf=0.05, c=c), y, r)[0] for c in (0.0, 1.0))
    np.testing.assert_allclose(calm[1], [2.0], **ROUND)
    np.testing.assert_allclose(kicked[1], [2.0 + 0.4 / 0.15], **ROUND)


def step_response(anti_windup, n=400, **more):
    """Output, unlimited sum and integral of a loop with a slow plant behind a tight limit."""
    law = design(model(), TS, Kp=2.0, Ki=1.0, limits=InputLimits((-1.2, 1.2)), anti_windup=anti_windup, **more)
    x, state, y, integral = np.zeros((1, 1)), law.init(1), [], []
    for k in range(n):
        state, command = law.control(k, state, x, Estimate(np.zeros((1, 1))), np.ones((1, 1)))
        y.append(x[0, 0])
        integral.append(law.integral(state)[0, 0])
        x = 0.98 * x + 0.02 * command.u
    return np.array(y), np.array(integral)


def test_anti_windup():
    """Without it the integral grows while the input is limited, and the output overshoots; all end at the reference."""
    responses = {name: step_response(name) for name in ("none", "back-calculation", "clamping")}
    overshoot = {name: y.max() - 1.0 for name, (y, _) in responses.items()}
    largest = {name: integral.max() for name, (_, integral) in responses.items()}
    assert overshoot["none"] > 0.1
    assert overshoot["none"] > 5.0 * max(overshoot["back-calculation"], overshoot["clamping"])
    assert largest["none"] > 1.5 * max(largest["back-calculation"], largest["clamping"])
    for y, _ in responses.values():
        np.testing.assert_allclose(y[-1], 1.0, atol=1e-3)


def test_the_integral_of_back_calculation_has_a_closed_form():
    """Oracle: the fixed point of I = I + s + (Ts / Tt) (u - v) for a constant error behind a limit."""
    law = design(model(), TS, Kp=1.0, Ki=2.0, limits=InputLimits((-3.0, 3.0)), Tt=0.5)
    y = np.zeros((200, 1))
    u, states = commanded(law, y, np.full_like(y, 4.0))
    assert (u == 3.0).all()
    # s = 2 * 0.1 * 4 per sample, u = 3 and v = 4 + I + s.
    np.testing.assert_allclose(law.integral(states[-1])[0, 0], -1.0 - 0.8 + 0.8 * 5.0, rtol=1e-9)
    assert law.integral(states[-1])[0, 0] < 2.0 * TS * 4.0 * 200


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"Kp": 2.0, "Ki": 4.0}, 0.5),
        ({"Kp": 2.0, "Ki": 4.0, "Kd": 1.0}, 0.5),
        ({"Kp": -2.0, "Ki": -8.0, "Kd": -2.0}, 0.5),
        ({"Kp": 0.0, "Ki": 4.0}, TS),
    ],
)
def test_default_tracking_time(keys, expected):
    """Oracle: sqrt(Ti Td), or Ti without a derivative, and at least Ts."""
    np.testing.assert_allclose(TS / design(model(), TS, **keys).correction, expected, **ROUND)


def test_a_missing_measurement_is_held():
    """Oracle: the same sequence with the last value in its place; before the first one it is y_op = 0."""
    y, r = np.random.default_rng(3).standard_normal((2, 12, 1))
    gaps, held = y.copy(), y.copy()
    gaps[0] = gaps[5:7] = np.nan
    held[0], held[5:7] = 0.0, y[4]
    law = design(model(), TS, **PID)
    np.testing.assert_array_equal(commanded(law, gaps, r)[0], commanded(law, held, r)[0])


def test_a_missing_measurement_does_not_reach_other_loops():
    """Oracle: the loops without gaps; an output of no loop may be missing at all samples.

    Trap: 0 times NaN is NaN, in a product with the matrix that selects the outputs.
    """
    y, r = np.random.default_rng(5).standard_normal((2, 12, 3))
    law = design(model(3, 2), TS, **PID, outputs=[2, 0])
    gaps = y.copy()
    gaps[:, 1] = gaps[4:7, 0] = np.nan
    found, whole = commanded(law, gaps, r)[0], commanded(law, y, r)[0]
    np.testing.assert_array_equal(found[:, 0], whole[:, 0])
    assert (found[4:7, 1] != whole[4:7, 1]).all()


def test_bumpless_start():
    """u(0) is the input before the start, whatever the reference; an integral of 0 jumps by Kp."""
    point = OperatingPoint(np.array([0.0]), np.array([5.0]), np.array([0.0]))
    around = LinearisedModel(np.array([[0.5]]), np.eye(1), np.eye(1), np.eye(1), np.eye(1), point=point)
    y, r = np.zeros((3, 1)), np.ones((3, 1))
    smooth, jumping = (commanded(design(around, TS, **PID, start=start), y, r)[0] for start in ("bumpless", "rest"))
    np.testing.assert_allclose(smooth[:2, 0], [5.0, 5.0 + 1.5 * TS], **ROUND)
    np.testing.assert_allclose(jumping[0, 0], 5.0 + 2.0 + 1.5 * TS, **ROUND)


def test_several_loops_are_single_loops_side_by_side():
    """Oracle: the single loops, with outputs that are exchanged, gains and limits of their own."""
    y, r = np.random.default_rng(4).standard_normal((2, 30, 2))
    keys = {"Kp": [1.0, 2.0], "Ki": [0.5, 0.0], "Kd": [0.0, 0.3], "Tf": 0.1, "b": [0.5, 1.0]}
    both = design(model(2, 2), TS, **keys, outputs=[1, 0], limits=InputLimits([(-1.0, 1.0), (-2.0, 0.5)]))
    found = commanded(both, y, r)[0]
    for loop, output, limits in ((0, 1, (-1.0, 1.0)), (1, 0, (-2.0, 0.5))):
        own = {name: value[loop] if isinstance(value, list) else value for name, value in keys.items()}
        single = design(model(), TS, **own, limits=InputLimits(limits))
        expected = commanded(single, y[:, [output]], r[:, [output]])[0]
        np.testing.assert_array_equal(found[:, loop], expected[:, 0])
        assert (expected == limits[1]).any()


def test_the_output_of_the_estimate():
    """Oracle: the loop on y for y = C x_hat + d0."""
    rng = np.random.default_rng(5)
    m = random_model(rng, 3, 2, 2)
    m = LinearModel(m.A, m.B, m.C, m.Q_w, m.R_v, d0=np.array([0.5, -1.0]))
    x_hat, r = rng.standard_normal((20, 3)), rng.standard_normal((20, 2))
    y = x_hat @ m.C.T + m.d0
    direct = commanded(design(m, TS, **PID), y, r)[0]
    estimated = commanded(design(m, TS, **PID, on="estimate"), np.full_like(y, np.nan), r, x_hat)[0]
    np.testing.assert_allclose(estimated, direct, rtol=1e-10, atol=1e-12)


def loop_matrix(law, filter_, plant, k=8):
    """Matrix of one period on [x, x_pred, integral, derivative, error], by the code that simulates."""
    n, n_hat, nu = len(plant.A), filter_.F.shape[1], plant.B.shape[1]
    sizes = np.cumsum([n, n_hat, nu, nu])
    x, x_pred, integral, derivative, error = np.split(np.eye(sizes[-1] + nu), sizes, axis=1)
    y = x @ plant.C.T
    state, estimate = filter_.correct(k, filter_.init(len(x))._replace(x_pred=x_pred), y)
    own = law.init(len(x))._replace(integral=integral, derivative=derivative, error=error)
    after, command = law.control(k, own, y, estimate, np.zeros((1, len(plant.C))))
    predicted = filter_.predict(k, state, command.u).x_pred
    moved = x @ plant.A.T + command.u @ plant.B.T
    return np.hstack([moved, predicted, after.integral, after.derivative, after.error]).T


@pytest.mark.parametrize("on", ["y", "estimate"])
def test_linear_law(on):
    """Oracle: the matrix of the loop that the simulation amounts to; it has the same eigenvalues but zeros."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        m, other = random_model(rng, 3, 2, 2), random_model(rng, 4, 2, 2)
        filter_ = kalman(m, 8, x0=np.zeros(3), P0=m.Q_w)
        law = design(m, TS, Kp=[0.2, 0.1], Ki=[0.5, 0.3], Kd=[0.02, 0.05], Tf=0.1, on=on)
        plant = LinearPlant(other.A, other.B, other.C, np.eye(3, 4))
        expected = np.abs(np.linalg.eigvals(loop_matrix(law, filter_, plant))).max()
        np.testing.assert_allclose(spectral_radius(plant, linear_pair(filter_, law)), expected, rtol=1e-9)


def test_parts_without_effect_add_no_pole():
    """An unused integral would have the pole 1: the radius is that of the proportional loop."""
    m = LinearModel([[0.9]], [[1.0]], [[1.0]], 1.0, 1.0)
    filter_ = kalman(m, 8, x0=np.zeros(1), P0=m.Q_w)
    plant = LinearPlant(m.A, m.B, m.C, np.eye(1))
    pair = linear_pair(filter_, design(m, TS, Kp=0.5))
    poles = [0.9 - 0.5, float((m.A - filter_.K[-1] @ m.C)[0, 0])]
    np.testing.assert_allclose(spectral_radius(plant, pair), np.abs(poles).max(), rtol=1e-9)


@pytest.mark.parametrize(
    ("keys", "key", "message"),
    [
        ({"Kp": [1.0, 2.0]}, "Kp", "a number or 1 numbers"),
        ({"Kp": 1.0, "limits": InputLimits((1.0, -1.0))}, "limits.u", "must be below"),
        ({"Kp": 1.0, "limits": InputLimits([(0.0, 1.0)] * 2)}, "limits.u", "2 pairs"),
        ({"Kp": 1.0, "outputs": [1]}, "outputs", "from 0 to 0"),
        ({"Kp": 1.0, "Ki": 1.0, "Tt": 0.01}, "Tt", "at least the sampling time"),
        ({"Kp": 1.0, "Tt": 1.0, "anti_windup": "none"}, "Tt", "no effect"),
        ({"Kp": 1.0, "start": "bumpless"}, "start", "needs an integral"),
    ],
)
def test_mistakes(keys, key, message):
    """Oracle: the key to blame and its reason."""
    with pytest.raises(DesignError, match=message) as found:
        design(model(), TS, **keys)
    assert found.value.parameter == key


def test_as_many_outputs_as_inputs():
    """Oracle: the sizes in the message, and the way out."""
    with pytest.raises(DesignError, match=r"has 2 and 1\); choose them by `outputs`"):
        design(model(2), TS, Kp=1.0)
    assert design(model(2), TS, Kp=1.0, outputs=[1]).rows.tolist() == [[0.0, 1.0]]
