"""The servomechanism at its friction events: exact equality, kicks by noise, chatter, states that are no numbers."""

import numpy as np
import pytest
from plants import servo_oracle as oracle
from plants.servo_oracle import TABLE_2, breakaway

from rmpc_bench.plants import servo
from rmpc_bench.types import Status

NO_NOISE = np.zeros((1, 4))
TS = 0.1


def moved(x, volts, p=TABLE_2, Ts=TS):
    """State after one sample; the run must end well."""
    plant = servo.design(Ts)
    delta = plant.draw({name: np.array([p[name]]) for name in plant.nominal}, [], 1)
    x_next, status = plant.step(0, delta, np.array([x], dtype=float), np.array([[volts]], dtype=float), NO_NOISE)
    assert status[0] == Status.OK
    return x_next[0]


def at_rest(load=0.0, motor=0.0):
    """State at rest with such torques on the bodies [N m]."""
    twist = load / TABLE_2["k_theta"]
    return np.array([0.0, 0.0, twist * TABLE_2["rho"], 0.0, (motor + load / TABLE_2["rho"]) / TABLE_2["K_t"]])


def steady(x):
    """Voltage that keeps the current of a state at rest."""
    return TABLE_2["R"] * x[4]


F_L, F_M = breakaway(TABLE_2, 0), breakaway(TABLE_2, 1)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("ulps", range(-3, 4))
def test_a_torque_equal_to_the_friction_holds_and_one_that_grows_does_not(sign, ulps):
    """Oracle: Filippov; at the breakaway torque to a few last places a motor rests until the torque grows."""
    x = at_rest(motor=sign * F_M * (1.0 + ulps * np.finfo(float).eps))
    for voltage in (0.0, 0.5 * steady(x)):
        np.testing.assert_array_equal(moved(x, voltage)[:4], x[:4])  # falls
    grown = moved(x, 2.0 * steady(x))
    assert sign * grown[3] > 0.0
    np.testing.assert_allclose(grown, oracle.flow(TABLE_2, x, 2.0 * steady(x), TS), rtol=0, atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_both_at_rest_and_a_constant_torque_at_the_limit_is_no_event(sign):
    """Oracle: by hand; the torque on a load beside a motor at rest cannot grow."""
    x = at_rest(load=sign * F_L)
    for motor_torque in (0.0, 0.9 * F_M, -0.9 * F_M):
        x[4] = (motor_torque + sign * F_L / TABLE_2["rho"]) / TABLE_2["K_t"]
        after = moved(x, steady(x))
        np.testing.assert_array_equal(after[:4], x[:4])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_motor_that_breaks_away_takes_a_load_at_the_limit_along(sign):
    """Oracle: both at exactly their limits; the motor's torque grows at first order, the load's at third."""
    x = at_rest(load=sign * F_L, motor=sign * F_M)
    after = moved(x, 3.0 * steady(x))
    assert sign * after[1] > 0.0 and sign * after[3] > 0.0
    np.testing.assert_allclose(after, oracle.flow(TABLE_2, x, 3.0 * steady(x), TS), rtol=0, atol=1e-11)


def test_a_release_at_the_end_of_a_sample_is_one_at_the_start_of_the_next():
    """Oracle: sampling times at, and some last places around, the instant of the release; the next sample agrees."""
    x, volts = at_rest(), 60.0
    current = F_M / TABLE_2["K_t"]  # the current that releases the motor, reached along an exponential
    release = -TABLE_2["L"] / TABLE_2["R"] * np.log(1.0 - current * TABLE_2["R"] / volts)
    ends = []
    for ulps in (-(2**20), -64, -2, -1, 0, 1, 2, 64, 2**20):
        first = release * (1.0 + ulps * np.finfo(float).eps)
        ends.append(moved(moved(x, volts, Ts=first), volts, Ts=TS - first))
    np.testing.assert_allclose(ends, np.tile(oracle.flow(TABLE_2, x, volts, TS), (len(ends), 1)), rtol=0, atol=1e-12)
    assert ends[0][3] > 0.0


def test_a_body_that_reverses_does_not_rest():
    """Oracle: the reference; the torque at the reversal exceeds the friction on the other side."""
    x = np.array([0.0, 0.0, 0.0, 0.5, 0.0])
    after = moved(x, -200.0)
    assert after[3] < 0.0
    np.testing.assert_allclose(after, oracle.flow(TABLE_2, x, -200.0, TS), rtol=0, atol=1e-11)


@pytest.mark.parametrize("excess", [1e-1, 1e-3, 1e-5, 1e-7])
def test_short_episodes_are_not_missed(excess):
    """Oracle: the reference; a motor slips for 0.1 s times the excess and stops."""
    x = at_rest(motor=F_M * (1.0 + excess))
    after = moved(x, 0.0)
    assert after[3] == 0.0 and after[2] > 0.0
    tight = oracle.flow(TABLE_2, x, 0.0, TS, rtol=1e-13, atol=1e-18, max_step=1e-3)
    assert after[2] == pytest.approx(tight[2], rel=1e-4, abs=1e-17)


def test_noise_that_kicks_velocities_changes_the_direction_of_friction():
    """Oracle: a sample from the kicked state, for which a fresh plant and the reference know of no past."""
    plant = servo.design(TS)
    delta = plant.draw({name: np.array([TABLE_2[name]]) for name in plant.nominal}, [], 1)
    w = np.array([[0.0, -0.4, 0.0, -9.0]])
    x = np.array([[0.0, 0.3, 0.0, 5.0, 0.2]])
    kicked = plant.step(0, delta, x, np.array([[20.0]]), w).x
    assert (kicked[0, [1, 3]] < 0.0).all()
    after = plant.step(1, delta, kicked, np.array([[20.0]]), NO_NOISE).x[0]
    np.testing.assert_allclose(after, oracle.flow(TABLE_2, kicked[0], 20.0, TS), rtol=0, atol=1e-11)
    held = plant.step(0, delta, np.zeros((1, 5)), np.zeros((1, 1)), np.array([[0.0, 0.0, 0.0, 1e-3]])).x
    assert plant.step(1, delta, held, np.zeros((1, 1)), NO_NOISE).x[0, 3] == 0.0  # a kick out of rest comes to rest


def test_a_body_that_chatters_is_marked_and_the_others_go_on():
    """Oracle: an undamped load reverses sqrt(k_theta / J_l) Ts / pi = 1139 times in a sample."""
    plant = servo.design(TS)
    light = {"J_l": 1e-6, "beta_l": 0.0, "alpha_l0": 1e-3, "alpha_l1": 0.0}
    p = {name: np.array([value, light.get(name, value), value]) for name, value in plant.nominal.items()}
    delta = plant.draw(p, [], 1)
    x, u, w = np.zeros((3, 5)), np.full((3, 1), 20.0), np.zeros((3, 4))
    x[1, 0] = 1e3
    motion = plant.step(0, delta, x, u, w)
    np.testing.assert_array_equal(motion.status, [Status.OK, Status.TOO_MANY_EVENTS, Status.OK])
    assert Status.TOO_MANY_EVENTS == 3 and Status.TOO_MANY_EVENTS.word == "too-many-events"
    alone = plant.step(0, plant.draw({k: v[:1] for k, v in p.items()}, [], 1), x[:1], u[:1], w[:1]).x
    np.testing.assert_array_equal(motion.x[[0, 2]], np.tile(alone, (2, 1)))


def states(rng, runs):
    """States of all kinds: slipping, at rest, at the limit of rest."""
    x = rng.standard_normal((runs, 5)) * [1.0, 0.5, 20.0, 5.0, 1.0]
    x[:, 2] = 20.0 * x[:, 0] + 0.1 * rng.standard_normal(runs)
    x[::3, 1], x[::2, 3] = 0.0, 0.0
    x[::5] = at_rest(motor=F_M)
    return x


def test_a_row_equals_a_batch_of_one_whatever_stands_beside_it(rng):
    """Oracle: each run alone, bit for bit; rows without numbers and of any size among them."""
    plant, runs = servo.design(TS), 40
    p = {name: value * rng.uniform(0.9, 1.1, runs) for name, value in plant.nominal.items()}
    x, u = states(rng, runs), rng.uniform(-60.0, 60.0, (runs, 1))
    x[3, 2], x[11, 3], x[17, 1], u[23, 0], x[29, 0] = np.nan, np.inf, 1e90, np.nan, -1e99
    together = plant.step(0, plant.draw(p, [], 1), x, u, np.zeros((runs, 4)))
    for i in range(runs):
        delta = plant.draw({name: values[i : i + 1] for name, values in p.items()}, [], 1)
        alone = plant.step(0, delta, x[i : i + 1], u[i : i + 1], NO_NOISE)
        np.testing.assert_array_equal(together.x[i], alone.x[0])
        assert together.status[i] == alone.status[0] == Status.OK
    np.testing.assert_array_equal(np.isnan(together.x).any(axis=1), np.isin(np.arange(runs), [3, 11, 23]))


@pytest.mark.parametrize("size", [1e8, 1e30, 1e90, 1e99])
def test_very_large_states_move_as_without_friction(size):
    """Oracle: the plant without friction, beside which a torque of 10 N m is nothing."""
    free = {name: 0.0 if name.startswith("alpha") else value for name, value in TABLE_2.items()}
    for i in range(5):
        x = np.zeros(5)
        x[i] = size
        with_friction, without = moved(x, 1.0), moved(x, 1.0, free)
        np.testing.assert_allclose(with_friction, without, rtol=0, atol=1e-4 * size if size == 1e8 else 1e-9 * size)


@pytest.mark.parametrize("x", [1e100, 1e200, np.inf, np.nan])
def test_states_beyond_all_bounds_are_no_numbers(x):
    """Oracle: NaN, which the loop turns into the status diverged."""
    assert np.isnan(moved(np.full(5, x), 1.0)).all()
    assert np.isnan(moved(np.zeros(5), x)).all()


@pytest.mark.parametrize(
    "changes",
    [
        dict.fromkeys(("alpha_l0", "alpha_l1", "alpha_m0", "alpha_m1"), 0.0),
        dict.fromkeys(("alpha_l0", "alpha_l1"), 0.0),
        dict.fromkeys(("alpha_m0", "alpha_m1"), 0.0),
        dict.fromkeys(("alpha_l2", "alpha_m2"), 0.0),
        dict.fromkeys(("alpha_l0", "alpha_m0"), 0.0),
        {"K_t": 0.0},
        {"k_theta": 0.0},
    ],
    ids=lambda changes: "-".join(changes),
)
def test_parameters_may_be_zero(changes):
    """Oracle: the reference with the same zeros."""
    p, x, ours = TABLE_2 | changes, np.array([0.0, 0.1, 0.0, -3.0, 0.1]), np.array([0.0, 0.1, 0.0, -3.0, 0.1])
    for _ in range(4):
        x, ours = oracle.flow(p, x, 40.0, TS), moved(ours, 40.0, p)
    np.testing.assert_allclose(ours, x, rtol=0, atol=1e-11)


@pytest.mark.parametrize("alpha_m2", [50.0, 1e4])
def test_a_sharp_decay_of_friction_is_not_jumped_over(alpha_m2):
    """Oracle: sampling ten times as often; a motor that slows down meets the peak of friction near standstill."""
    p, x = TABLE_2 | {"alpha_m2": alpha_m2}, np.array([0.0, 0.0, 0.0, 8.0, 0.0])
    fine = x
    for _ in range(10):
        fine = moved(fine, 0.0, p, Ts=TS / 10)
    np.testing.assert_allclose(moved(x, 0.0, p), fine, rtol=0, atol=1e-12)


def test_friction_too_small_to_be_seen_at_first_is_not_forgotten():
    """Oracle: sampling thirty times as often; exp(-alpha_2 |w|) starts at 2e-19 and is 1 before the sample has ended.

    A load runs backwards and drags a motor that runs forwards; braked late, the motor reverses.  Over a third of the
    sample the series seems to have ended before its friction shows.
    """
    p = dict(TABLE_2, L=1.74, J_m=0.165, beta_m=0.1, R=13.8, K_t=5.45, rho=7.37, k_theta=1280.0, J_l=47.0, beta_l=32.3)
    p |= {"alpha_l1": 30.2, "alpha_m1": 2.4, "alpha_m2": 0.744}
    start = np.array([0.0, -61.9, -0.00243, 57.7, 0.0])
    ends = []
    for n in (30, 1, 2, 3, 4, 5):
        x = start
        for _ in range(n):
            x = moved(x, 0.0, p, Ts=TS / n)
        ends.append(x)
    assert ends[0][3] < 0.0
    np.testing.assert_allclose(ends[1:], np.tile(ends[0], (5, 1)), rtol=0, atol=1e-12)
