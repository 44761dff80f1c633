"""Speed of the parallel robot's kernel at block size; `pytest -m perf` of this file prints the table.

Nothing here asserts a time.
"""

import numpy as np
import pytest
from models import moving_slide_twin as twin

from rmpc_bench.models import moving_slide as model
from rmpc_bench.plants import moving_slide as plant

pytestmark = pytest.mark.perf

BLOCK, TS = 50, 0.01


def block():
    """States and torques of a block."""
    rng = np.random.default_rng(5)
    x = rng.uniform(-1.0, 1.0, (BLOCK, 6)) * [0.08, 0.08, 0.3, 0.3, 0.3, 1.0]
    return x, 0.3 * rng.standard_normal((BLOCK, 4))


def slopes(x, u):
    """Time derivatives of the states of a block in NumPy, with the nominal numbers."""
    p, v = model.NUMBERS, x[:, 3:]
    joints, lengths, J = model.arms(x[:, :3], p["a"], p["b"])
    e = (joints - p["a"] * model.CORNERS) / lengths[..., None]
    lever = joints - x[:, None, :2]
    S = np.concatenate([e, (e[..., 1] * lever[..., 0] - e[..., 0] * lever[..., 1])[..., None]], axis=2)
    turn, slide = np.einsum("ram,rm->ra", J, v), np.einsum("ram,rm->ra", S, v)
    dJ = -turn[..., None] * S
    dJ[..., 2] += v[:, 2, None] * S[..., 2]
    dJ = (dJ - J * slide[..., None]) / lengths[..., None]
    M = p["I_arm"] * np.einsum("ram,ran->rmn", J, J)
    M += np.diag([p["m_p"] + 4 * p["m_s"]] * 2 + [p["I_p"] + 8 * p["m_s"] * p["b"] ** 2])
    torque = u - p["I_arm"] * np.einsum("ram,rm->ra", dJ, v) - p["d_rot"] * turn
    force = np.einsum("ram,ra->rm", J, torque) - p["d_sl"] * np.einsum("ram,ra->rm", S, slide)
    return np.concatenate([v, np.linalg.solve(M, force[..., None])[..., 0]], axis=1)


def numpy_step(x, u, h=TS / 2):
    """A sample of two steps of Runge and Kutta in NumPy, for the whole block at once."""
    for _ in range(2):
        k1 = slopes(x, u)
        k2 = slopes(x + h / 2 * k1, u)
        k3 = slopes(x + h / 2 * k2, u)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + slopes(x + h * k3, u))
    return x


def test_robot_sample_kernel(benchmark):
    """50 runs over a sample, statuses included."""
    robot, (x, u) = plant.design(TS), block()
    delta = robot.draw({name: np.full(BLOCK, value) for name, value in robot.nominal.items()}, [], 1)
    end = benchmark(robot.step, 0, delta, x, u, np.zeros((BLOCK, 6)))
    np.testing.assert_allclose(end.x, numpy_step(x, u), rtol=0.0, atol=1e-12)  # another order of the sums


def test_robot_sample_numpy(benchmark):
    """The same in NumPy; numba has to beat it by a factor of three."""
    benchmark(numpy_step, *block())


def test_robot_pair_kernel(benchmark):
    """Matrices of 50 runs at their states."""
    benchmark(model.design(TS).at_state, block()[0])


def test_robot_pair_plain(benchmark):
    """The same by the plain twin, run after run, with scipy's exponential."""
    x, _ = block()
    A = benchmark.pedantic(lambda: [twin.pair(twin.robot(), row, TS)[0] for row in x], rounds=2)
    np.testing.assert_allclose(model.design(TS).at_state(x).A, A, rtol=0.0, atol=1e-13)
