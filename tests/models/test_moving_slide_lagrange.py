"""The equations of motion of the parallel robot against Lagrange's, derived by sympy from angles and lengths alone."""

import numpy as np
import pytest
from models import moving_slide_twin as twin

from rmpc_bench.models.moving_slide import design

pytestmark = pytest.mark.slow


def lagrange():
    """Compiled (M, forces) of M v' = forces, as functions of the state, the torques and the numbers of a robot."""
    import sympy as sp

    y, v, tau = sp.symbols("x_c y_c psi"), sp.symbols("vx vy w"), sp.symbols("tau1:5")
    names = sp.symbols("a b m_p I_p m_s I_arm d_rot d_sl")
    a, b, m_p, I_p, m_s, I_arm, d_rot, d_sl = names

    def rate(expression):
        return sum(sp.diff(expression, each) * speed for each, speed in zip(y, v, strict=True))

    kinetic = (m_p * (v[0] ** 2 + v[1] ** 2) + I_p * v[2] ** 2) / 2
    dissipation = power = 0
    for (i, j), torque in zip(twin.CORNERS, tau, strict=True):
        dx = y[0] + b * (i * sp.cos(y[2]) - j * sp.sin(y[2])) - i * a
        dy = y[1] + b * (i * sp.sin(y[2]) + j * sp.cos(y[2])) - j * a
        theta, length = sp.atan2(dy, dx), sp.sqrt(dx**2 + dy**2)
        turn, slide = rate(theta), rate(length)
        kinetic += (I_arm * turn**2 + m_s * (slide**2 + length**2 * turn**2)) / 2  # the slide in polar coordinates
        dissipation += (d_rot * turn**2 + d_sl * slide**2) / 2
        power += torque * turn
    momenta = [sp.diff(kinetic, each) for each in v]
    M = sp.Matrix([[sp.diff(momentum, each) for each in v] for momentum in momenta])
    forces = [
        sp.diff(power, speed) - sp.diff(dissipation, speed) + sp.diff(kinetic, place) - rate(momentum)
        for place, speed, momentum in zip(y, v, momenta, strict=True)
    ]
    return sp.lambdify([*y, *v, *tau, *names], [M, sp.Matrix(forces)], "numpy", cse=True)


def test_the_model_obeys_lagranges_equations(rng):
    """Oracle: sympy; the acceleration K v + M^-1 J' tau at random states, torques and robots."""
    derived = lagrange()
    for _ in range(30):
        x = rng.uniform(-1.0, 1.0, 6) * [0.1, 0.1, 0.5, 0.5, 0.5, 1.5]
        tau, keys = rng.standard_normal(4), {"mass": 1.0}
        keys |= {name: value * rng.uniform(0.9, 1.1) for name, value in twin.robot().items()}
        M, forces = derived(*x, *tau, *[value for name, value in keys.items() if name != "mass"])
        A, B = design(1.0, discretisation="euler", **keys).at_state(x[None])
        ours = (A[0, 3:, 3:] - np.eye(3)) @ x[3:] + B[0, 3:] @ tau
        np.testing.assert_allclose(ours, np.linalg.solve(M, forces)[:, 0], rtol=0.0, atol=1e-10)  # of up to 50 rad/s^2
        np.testing.assert_allclose(twin.matrices(twin.robot(**keys), x)[0], M, rtol=0.0, atol=1e-12)
