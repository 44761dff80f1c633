"""The servomechanism's linear plant, process noise and parameters without meaning."""

import numpy as np
import pytest
from plants.servo_oracle import TABLE_2
from scipy.linalg import expm

from rmpc_bench.plants import servo
from rmpc_bench.types import DesignError, Status

NO_NOISE = np.zeros((1, 4))


def parameters(plant, runs, **changes):
    """Nominal parameters of a block with some columns replaced."""
    return {name: np.full(runs, value) for name, value in plant.nominal.items()} | changes


def test_the_linear_plant_is_the_matrix_exponential(rng):
    """Oracle: scipy.linalg.expm of the equations of section 4.2 with the voltage as a constant sixth state."""
    p, x, u = TABLE_2, rng.standard_normal(4), 30.0
    k, rho = p["k_theta"], p["rho"]
    A = np.zeros((5, 5))
    A[0, 1] = A[2, 3] = 1.0
    A[1, :3] = np.array([-k, -p["beta_l"], k / rho]) / p["J_l"]
    damping = p["beta_m"] + p["K_t"] ** 2 / p["R"]
    A[3, [0, 2, 3, 4]] = np.array([k / rho, -k / rho**2, -damping, p["K_t"] / p["R"]]) / p["J_m"]
    plant = servo.design_linear(0.1)
    delta = plant.draw({name: np.array([p[name]]) for name in plant.nominal}, [], 1)
    ours = plant.step(0, delta, x[None], np.array([[u]]), NO_NOISE).x[0]
    np.testing.assert_allclose(ours, (expm(A * 0.1) @ np.append(x, u))[:4], atol=1e-12)


@pytest.mark.parametrize("design", [servo.design, servo.design_linear])
def test_process_noise_kicks_the_end_of_the_sample(design, rng):
    """Oracle: x(k+1) with w minus x(k+1) without is w on the first four states."""
    plant = design(0.1)
    delta = plant.draw(parameters(plant, 1), [], 1)
    x, w = rng.standard_normal((1, plant.nx)), rng.standard_normal((1, 4))
    quiet, kicked = (plant.step(0, delta, x, np.ones((1, 1)), noise).x for noise in (NO_NOISE, w))
    np.testing.assert_array_equal(kicked[:, :4], quiet[:, :4] + w)
    np.testing.assert_array_equal(kicked[:, 4:], quiet[:, 4:])


@pytest.mark.parametrize("design", [servo.design, servo.design_linear])
def test_the_output_is_the_load_angle_plus_noise(design, rng):
    """Oracle: y = th_l + v."""
    plant = design(0.1)
    x, v = rng.standard_normal((3, plant.nx)), rng.standard_normal((3, 1))
    delta = plant.draw(parameters(plant, 3), [], 1)
    np.testing.assert_array_equal(plant.output(0, delta, x, v), x[:, :1] + v)


BAD = [("J_l", 0.0), ("J_m", -1.0), ("R", 0.0), ("rho", 0.0), ("beta_l", -1e-9), ("K_t", -1.0), ("J_l", np.nan)]


@pytest.mark.parametrize("design", [servo.design, servo.design_linear])
@pytest.mark.parametrize(("name", "value"), [*BAD, ("k_theta", np.inf)])
def test_parameters_without_meaning_mark_their_run_only(design, name, value):
    """Oracle: status out-of-range in row 1; rows 0 and 2 have the bits of a block without it."""
    plant = design(0.1)
    x, u = np.ones((3, plant.nx)), np.full((3, 1), 20.0)
    good = plant.draw(parameters(plant, 3), [], 1)
    bad = plant.draw(parameters(plant, 3, **{name: np.array([plant.nominal[name], value, plant.nominal[name]])}), [], 1)
    motion, expected = (plant.step(0, delta, x, u, np.zeros((3, 4))) for delta in (bad, good))
    np.testing.assert_array_equal(motion.status, [Status.OK, Status.OUT_OF_RANGE, Status.OK])
    np.testing.assert_array_equal(motion.x[[0, 2]], expected.x[[0, 2]])
    assert np.isfinite(motion.x).all()


@pytest.mark.parametrize(("name", "value"), [("L", 0.0), ("L", -0.1), ("alpha_l0", -1.0), ("alpha_m2", -0.5)])
def test_inductance_and_friction_have_a_range_too(name, value):
    """Oracle: L divides, and a negative friction would drive."""
    plant = servo.design(0.1)
    delta = plant.draw(parameters(plant, 1, **{name: np.array([value])}), [], 1)
    np.testing.assert_array_equal(delta.status, [Status.OUT_OF_RANGE])


@pytest.mark.parametrize(
    "changes", [{"L": 1e-6}, {"J_l": 1e-6}, {"J_l": 1e-300}, {"J_m": 1e-9, "alpha_m1": 0.0}, {"k_theta": 1e14}]
)
def test_motion_too_fast_to_follow_is_refused(changes):
    """Oracle: the fastest mode is 1e5 samples^-1 or faster; a design raises, a drawn run is marked, others go on."""
    with pytest.raises(DesignError, match="Ts of the linear part exceeds"):
        servo.design(0.1, **changes)
    plant = servo.design(0.1)
    columns = {name: np.array([plant.nominal[name], value]) for name, value in changes.items()}
    delta = plant.draw(parameters(plant, 2, **columns), [], 1)
    np.testing.assert_array_equal(delta.status, [Status.OK, Status.OUT_OF_RANGE])
    moved = plant.step(0, delta, np.zeros((2, 5)), np.full((2, 1), 50.0), np.zeros((2, 4)))
    np.testing.assert_array_equal(moved.x[0], moved.x[1])  # the marked run goes on with the nominal parameters


@pytest.mark.parametrize(
    "changes", [{"L": 1e-3}, {"J_l": 1e-2}, {"J_l": 1e12}, {"J_m": 1e-3}, {"J_l": 1e6, "J_m": 1e-3}, {"k_theta": 1e8}]
)
def test_extreme_parameters_take_long_and_arrive(changes):
    """Oracle: two halves of a sample make a whole; bounds the error that grows with the number of series."""
    whole, half = servo.design(0.1, **changes), servo.design(0.05, **changes)
    u, ends = np.full((1, 1), 40.0), []
    for plant, n in ((whole, 3), (half, 6)):
        delta, x = plant.draw(parameters(plant, 1), [], 1), np.zeros((1, 5))
        for k in range(n):
            x, status = plant.step(k, delta, x, u, NO_NOISE)
            assert status[0] == Status.OK
        ends.append(x)
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-9, atol=1e-11)


def test_the_designs_have_the_parameters_of_table_1_and_2():
    """Oracle: Tables 1 and 2 of the paper at eps = 0."""
    nominal = dict(servo.design(0.1).nominal)
    table = dict(J_m=0.5, beta_m=0.1, R=20.0, K_t=10.0, rho=20.0, k_theta=1280.2, J_l=25.0, beta_l=25.0)
    assert dict(servo.design_linear(0.1).nominal) == table
    friction = dict(alpha_l0=0.5, alpha_l1=10.0, alpha_l2=0.5, alpha_m0=0.1, alpha_m1=2.0, alpha_m2=0.5)
    assert nominal == table | friction | {"L": 0.8}


def test_warming_up_leaves_no_trace():
    """Oracle: a step after warm_up has the bits of a step without."""
    cold, warm = servo.design(0.1), servo.design(0.1)
    warm.warm_up()
    moved = [
        plant.step(0, plant.draw(parameters(plant, 1), [], 1), np.zeros((1, 5)), np.full((1, 1), 50.0), NO_NOISE).x
        for plant in (cold, warm)
    ]
    np.testing.assert_array_equal(*moved)
