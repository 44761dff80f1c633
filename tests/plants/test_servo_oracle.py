"""The event-driven reference of the servomechanism judged by itself, by a cruder method and by linear algebra."""

import numpy as np
import pytest
from plants import servo_oracle as oracle
from plants.servo_oracle import TABLE_2, breakaway, closed_loop, drive, fine_step, flow, friction_mode
from scipy.linalg import expm

P = TABLE_2
TS = 0.1
FRICTIONLESS = {key: 0.0 if key.startswith("alpha") else value for key, value in P.items()}
TIGHT = {"rtol": 1e-13, "atol": 1e-15, "max_step": 2e-3}
COARSE = {"rtol": 1e-8, "atol": 1e-10, "max_step": 1e-2}


def bang_bang(k: int) -> float:
    """60 V forth, rest, 60 V back, rest: the pauses are long enough to stick in."""
    return (60.0, 0.0, -60.0, 0.0)[k // 8 % 4]


def ramp(k: int) -> float:
    """From -30 V to 30 V: slips, sticks around zero, breaks away again."""
    return 30.0 * (k / 17 - 1)


SEQUENCES = pytest.mark.parametrize("voltage", [bang_bang, ramp])


def trajectory(step, voltage, n=35, **options):
    """States at 0 .. n under a sequence of voltages."""
    states = [np.zeros(5)]
    for k in range(n):
        states.append(step(P, states[-1], voltage(k), TS, **options))
    return np.array(states)


@SEQUENCES
def test_two_tolerances_agree_on_trajectories_that_stick_and_slip(voltage):
    coarse, tight = trajectory(flow, voltage, **COARSE), trajectory(flow, voltage, **TIGHT)
    for speed in (1, 3):
        at_rest = tight[1:, speed] == 0
        assert at_rest.any() and not at_rest.all()
        np.testing.assert_array_equal(coarse[1:, speed] == 0, at_rest)
    np.testing.assert_allclose(coarse, tight, rtol=0, atol=1e-9)


@SEQUENCES
def test_the_impulse_scheme_converges_to_the_events_at_first_order(voltage):
    reference = trajectory(flow, voltage)
    steps = (4e-4, 2e-4, 1e-4)
    errors = [np.abs(trajectory(fine_step, voltage, h=h) - reference)[:, [0, 2]].max() for h in steps]
    assert errors[-1] < 3e-3
    for large, small in zip(errors[:-1], errors[1:], strict=True):
        assert 1.7 < large / small < 2.3


def test_the_flow_composes():
    x = flow(P, np.zeros(5), 80.0, 0.5)
    for u in (0.0, -40.0, 3.0):
        whole = flow(P, x, u, 1.0)
        halves = flow(P, flow(P, x, u, 0.37), u, 0.63)
        np.testing.assert_allclose(halves, whole, rtol=0, atol=1e-10)
        x = whole


@pytest.mark.parametrize("u", [0.0, 100.0])
def test_without_friction_the_flow_is_the_matrix_exponential(u):
    p, k, rho = FRICTIONLESS, P["k_theta"], P["rho"]
    a = np.zeros((6, 6))
    a[0, 1] = a[2, 3] = 1
    a[1, :3] = np.array([-k, -p["beta_l"], k / rho]) / p["J_l"]
    a[3, [0, 2, 3, 4]] = np.array([k / rho, -k / rho**2, -p["beta_m"], p["K_t"]]) / p["J_m"]
    a[4, [3, 4, 5]] = np.array([-p["K_t"], -p["R"], 1]) / p["L"]
    x = np.array([0.1, -0.5, 3.0, 2.0, 0.4])
    expected = (expm(a * 0.7) @ np.append(x, u))[:5]
    np.testing.assert_allclose(flow(p, x, u, 0.7), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(flow(p, np.zeros(5), u, 0.7), (expm(a * 0.7) @ [0, 0, 0, 0, 0, u])[:5], atol=1e-9)


@pytest.mark.parametrize("share", [-0.99, -0.5, 0.3, 0.99, 1.0])
def test_below_breakaway_both_bodies_stay_exactly(share):
    u = share * breakaway(P, 1) / P["K_t"] * P["R"]
    x = np.array([0.3, 0.0, 0.3 * P["rho"], 0.0, 0.0])
    end = flow(P, x, u, 5.0)
    np.testing.assert_array_equal(end[:4], x[:4])
    assert end[4] == pytest.approx(u / P["R"], abs=1e-9)
    np.testing.assert_array_equal(fine_step(P, x, u, 5.0, 1e-3)[:4], x[:4])


@pytest.mark.parametrize("body", [0, 1])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_mode_at_rest_is_decided_by_the_torque(body, sign):
    def at(share):
        torque = sign * share * breakaway(P, body)
        # a twist of the shaft moves the load; the current moves the motor
        twist = torque / P["k_theta"] if body == 0 else 0.0
        motor_current = twist * P["k_theta"] / P["rho"] / P["K_t"] + (torque / P["K_t"] if body else 0.0)
        return np.array([0.0, 0.0, twist * P["rho"], 0.0, motor_current])

    assert drive(P, at(1.0))[body] == pytest.approx(sign * breakaway(P, body))
    assert drive(P, at(1.0))[1 - body] == pytest.approx(0.0, abs=1e-12)
    assert friction_mode(P, at(0.999))[body] == 0
    assert friction_mode(P, at(1.0))[body] == 0
    assert friction_mode(P, at(1.001))[body] == sign
    assert friction_mode(P, at(1.001))[1 - body] == 0


def energy(x):
    """Kinetic, magnetic and elastic energy."""
    twist = x[2] / P["rho"] - x[0]
    return (P["J_l"] * x[1] ** 2 + P["J_m"] * x[3] ** 2 + P["L"] * x[4] ** 2 + P["k_theta"] * twist**2) / 2


def test_without_voltage_the_energy_never_grows_and_all_comes_to_rest():
    x = np.array([0.0, 1.0, 6.0, -20.0, 3.0])
    levels = [energy(x)]
    for _ in range(400):
        x = flow(P, x, 0.0, 0.01)
        levels.append(energy(x))
    assert np.all(np.diff(levels) <= 1e-10)
    assert levels[-1] < 0.05 * levels[0]
    assert x[1] == x[3] == 0.0


@pytest.mark.parametrize("excess", [1e-1, 1e-2, 1e-3, 1e-4])
def test_short_slip_episodes_are_not_missed(excess):
    """A decaying current lets the motor slip for milliseconds down to microseconds, within one step of the flow."""
    x = np.array([0.0, 0.0, 0.0, 0.0, breakaway(P, 1) * (1 + excess) / P["K_t"]])
    assert friction_mode(P, x) == (0, 1)
    coarse, tight = flow(P, x, 0.0, TS, **COARSE), flow(P, x, 0.0, TS, **TIGHT)
    assert coarse[3] == tight[3] == 0.0
    assert coarse[2] == pytest.approx(tight[2], rel=1e-4, abs=0)  # of 4e-15 rad in the shortest
    # the episode lasts about 0.1 s times the excess, so the crude method sees it in equally many steps
    fine = fine_step(P, x, 0.0, 0.2 * excess, 2e-5 * excess)
    assert fine[3] == 0.0
    assert fine[2] == pytest.approx(tight[2], rel=2e-3, abs=0)


def count_pieces(monkeypatch):
    """Count the smooth pieces of all flows from here on."""
    counter, piece = [0], oracle._piece

    def counted(*args):
        counter[0] += 1
        return piece(*args)

    monkeypatch.setattr(oracle, "_piece", counted)
    return counter


def test_grazing_a_boundary_is_continuous(monkeypatch):
    """Where the number of events changes between adjacent doubles, the end states agree."""
    counter = count_pieces(monkeypatch)

    def run(u):
        counter[0] = 0
        end = flow(P, flow(P, np.zeros(5), u, 0.3, **COARSE), -0.2 * u, 0.4, **COARSE)
        return counter[0], end

    grid = np.linspace(2.0, 40.0, 20)
    counts = [run(u)[0] for u in grid]
    changes = np.flatnonzero(np.diff(counts))
    assert changes.size >= 3
    for i in changes[:3]:
        low, high = grid[i], grid[i + 1]
        first = counts[i]
        while np.nextafter(low, high) < high:
            middle = (low + high) / 2
            low, high = (middle, high) if run(middle)[0] == first else (low, middle)
        np.testing.assert_allclose(run(low)[1], run(high)[1], rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("coefficients", "expected"),
    [
        ([0, 0, 1.0, -2.0, 0, 0, 0, 0], 0.5),  # released at rest, stops in the middle
        ([0, 1.0, -1e6, 0, 0, 0, 0, 0], 1e-6),  # an episode of a millionth of a step
        ([1.0, -4.0, 4.0, 0, 0, 0, 0, 0], None),  # touches zero without crossing
        ([0.24, -1.0, 1.0, 0, 0, 0, 0, 0], 0.4),  # dips below zero between the ends
        ([0, -1.0, 2.0, 0, 0, 0, 0, 0], 0.0),  # negative at once
        ([1.0, 1.0, 1.0, 0, 0, 0, 0, 0], None),
        ([0, 0, 0, 0, 0, 0, 0, 0], None),
    ],
)
def test_the_first_descent_of_a_polynomial(coefficients, expected):
    found = oracle._first_descent(np.array(coefficients, dtype=float))
    assert found == (None if expected is None else pytest.approx(expected, rel=1e-9, abs=1e-15))


def test_the_closed_loop_samples_the_flow():
    seen = []

    def controller(k, y):
        seen.append((k, y))
        return 40.0 * (1.0 - y)

    y, u = closed_loop(P, controller, 20, rtol=1e-9)
    assert y.shape == (21,) and u.shape == (20,)
    assert y[0] == 0 and seen == list(enumerate(y[:-1]))
    np.testing.assert_allclose(u, 40.0 * (1.0 - y[:-1]))
    np.testing.assert_allclose(y, trajectory(flow, lambda k: u[k], n=20)[:, 0], rtol=0, atol=1e-9)


def test_an_inductance_of_zero_is_refused():
    with pytest.raises(ValueError, match="inductance"):
        flow(P | {"L": 0.0}, np.zeros(5), 1.0, TS)
