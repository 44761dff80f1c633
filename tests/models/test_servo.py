"""The linear servomechanism against servo.md section 1 and the equations of the paper."""

import numpy as np
import pytest
from conftest import servo_model

from rmpc_bench.models.servo import TABLE_1, ServoNoise, continuous, design

# servo.md section 1, from another program, printed with 11 and 10 digits.
A = """7.6367268176e-01  8.7269412617e-02  1.1816365912e-02  3.1836323435e-04
       -4.4281352200e+00  6.7640326914e-01  2.2140676100e-01  8.5690609217e-03
       4.4437120780e-01  1.5918161717e-02  9.7778143961e-01  6.2050517508e-02
       7.1285700261e+00  4.2845304608e-01 -3.5642850131e-01  3.4486616103e-01"""
B = "8.4662269379e-06 3.1836323435e-04 3.6404322391e-03 6.2050517508e-02"
Q_W = """0.085254176  -0.2045241784  0.0144832733  0.3959368095
         -0.2045241784  0.8040910637 -0.0436199111 -1.3057935885
         0.0144832733 -0.0436199111  0.1030634169  0.0788129843
         0.3959368095 -1.3057935885  0.0788129843  2.456894133"""
POLES = [-9.79009, -0.70495 - 7.31498j, -0.70495 + 7.31498j, 0.0]


def numbers(text, *shape):
    """Read a printed matrix."""
    return np.array(text.split(), dtype=float).reshape(shape)


def test_the_sampled_model_has_the_published_numbers():
    """Oracle: servo.md section 1, to the digits printed there."""
    model = servo_model()
    np.testing.assert_allclose(model.A, numbers(A, 4, 4), rtol=1e-9)
    np.testing.assert_allclose(model.B, numbers(B, 4, 1), rtol=1e-9)
    np.testing.assert_allclose(model.Q_w, numbers(Q_W, 4, 4), rtol=1e-8)
    np.testing.assert_array_equal(model.R_v, [[1.0]])
    np.testing.assert_array_equal(model.C, [[1.0, 0.0, 0.0, 0.0]])


def test_the_poles_are_the_published_ones():
    """Oracle: servo.md section 1, five decimals."""
    poles = np.sort_complex(np.linalg.eigvals(continuous(TABLE_1)[0]))
    np.testing.assert_allclose(poles, POLES, atol=6e-6)


def test_the_continuous_model_obeys_the_equations_of_motion(rng):
    """Oracle: section 4.1 of the paper evaluated with L = 0 and no friction, at random parameters and states."""
    p = {name: value * rng.uniform(0.5, 2.0) for name, value in TABLE_1.items()}
    (th_l, w_l, th_m, w_m), V = x, u = rng.standard_normal(4), rng.standard_normal()
    T_s = p["k_theta"] / p["rho"] * (th_m / p["rho"] - th_l)
    current = (V - p["K_t"] * w_m) / p["R"]
    expected = [
        w_l,
        (p["rho"] * T_s - p["beta_l"] * w_l) / p["J_l"],
        w_m,
        (p["K_t"] * current - T_s - p["beta_m"] * w_m) / p["J_m"],
    ]
    A_bar, B_bar = continuous(p)
    np.testing.assert_allclose(A_bar @ x + B_bar[:, 0] * u, expected, rtol=1e-10)  # cancellation of the torques


def test_the_shaft_turns_freely_as_a_rigid_body():
    """Oracle: servo.md 3.4; turning the motor by rho turns the load by 1 and nothing moves, A v = v."""
    v = np.array([1.0, 0.0, 20.0, 0.0])
    np.testing.assert_allclose(servo_model().A @ v, v, atol=1e-12)


def test_noise_scales_with_its_intensity():
    """Oracle: covariances are quadratic in the intensities; four numbers are the diagonal of G-bar."""
    base = servo_model()
    scaled = design(0.1, noise=ServoNoise(process=0.1, measurement=0.2))
    np.testing.assert_allclose(scaled.Q_w, 0.01 * base.Q_w, rtol=1e-11)
    np.testing.assert_allclose(scaled.R_v, [[0.04]])
    by_list = design(0.1, noise=ServoNoise(process=[0.1, 0.1, 0.1, 0.1], measurement=0.2))
    np.testing.assert_array_equal(by_list.Q_w, scaled.Q_w)


def test_a_light_motor_is_a_model_too():
    """Oracle: J_m = 0.01 is allowed by its annotation; the noise covariance must come out as one."""
    model = design(0.1, noise=ServoNoise(process=1.0, measurement=1.0), J_m=0.01)
    assert np.linalg.eigvalsh(model.Q_w)[0] > 0.0


@pytest.mark.parametrize("Ts", [0.01, 0.1, 0.5])
def test_two_half_samples_make_a_whole(Ts):
    """Oracle: the semigroup property of the held input and of the white noise."""
    noise = ServoNoise(process=[1.0, 2.0, 3.0, 4.0], measurement=1.0)
    half, whole = design(Ts / 2, noise=noise), design(Ts, noise=noise)
    np.testing.assert_allclose(half.A @ half.A, whole.A, atol=1e-11)
    np.testing.assert_allclose(half.A @ half.B + half.B, whole.B, atol=1e-11)
    Q_w = half.A @ half.Q_w @ half.A.T + half.Q_w
    np.testing.assert_allclose(Q_w, whole.Q_w, rtol=0, atol=1e-11 * np.abs(Q_w).max())
