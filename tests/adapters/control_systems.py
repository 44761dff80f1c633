"""Systems of python-control and the same equations as an ODE plant, for the tests of the adapter."""

import numpy as np
import pytest

pytest.importorskip("control")

import control

from rmpc_bench.plants import ode

PARAMETERS = {"a1": 7.1e-6, "a2": 5.7e-6, "area": 2.8e-3}
NAMES = {"states": ["h1", "h2"], "inputs": ["pump"], "outputs": ["level"]}
BOUNDS = {"h1": (1e-4, 0.6), "h2": (1e-4, 0.6), "pump": (0.0, 30.0)}
X0 = np.array([0.065, 0.1])
TS = 3.0


def update(t, x, u, params):
    """Time derivatives of two tanks in series, as python-control calls them."""
    q1 = params["a1"] * np.sqrt(2 * 9.81 * x[0])
    q2 = params["a2"] * np.sqrt(2 * 9.81 * x[1])
    return [(1e-6 * u[0] - q1) / params["area"], (q1 - q2) / params["area"]]


def level(t, x, u, params):
    """Level of the second tank."""
    return [x[1]]


def tanks(**changes):
    """Two tanks in series as a system of python-control."""
    keys = {"params": PARAMETERS, "name": "tanks", **NAMES, **changes}
    return control.nlsys(keys.pop("update", update), keys.pop("output", level), **keys)


def with_actuator():
    """The tanks with a slow pump: a system of systems, which takes one run at a time."""
    pump = control.ss([[-0.2]], [[0.2]], [[1.0]], 0, name="pump", inputs=["v"], outputs=["pump"], states=["flow"])
    return control.interconnect([tanks(), pump], inputs=["v"], outputs=["level"])


def ode_tanks(**keys):
    """The tanks as an ODE plant."""
    return ode.design(
        TS, 100, ode=lambda x, u, p: update(0.0, x, u, p), output=lambda x, p: [x[1]], **NAMES, parameters=PARAMETERS,
        **{"bounds": BOUNDS, "x0": X0, **keys},
    )  # fmt: skip


def oscillator(m=1.0, k=2.0, d=0.3):
    """A mass with a spring and a damper."""
    names = {"states": ["place", "speed"], "inputs": ["force"], "outputs": ["place"]}
    return control.ss([[0.0, 1.0], [-k / m, -d / m]], [[0.0], [1.0 / m]], [[1.0, 0.0]], 0, **names)


def drawn(plant, n_runs, rng):
    """Parameters of some runs, within 10 % of the nominal ones."""
    columns = {name: value * rng.uniform(0.9, 1.1, n_runs) for name, value in plant.nominal.items()}
    return plant.draw(columns, [np.random.default_rng(i) for i in range(n_runs)], 100)


def trajectory(plant, n_runs=5, n_steps=50, low=0.05, high=0.3, size=30.0):
    """States and outputs with random parameters, states and inputs; the same numbers for plants of the same sizes."""
    rng = np.random.default_rng(3)
    delta, x = drawn(plant, n_runs, rng), rng.uniform(low, high, (n_runs, plant.nx))
    found = []
    for k in range(n_steps):
        y = plant.output(k, delta, x, np.zeros((n_runs, plant.nv)))
        motion = plant.step(k, delta, x, rng.uniform(0.0, size, (n_runs, plant.nu)), np.zeros((n_runs, plant.nw)))
        assert not motion.status.any()
        x = motion.x
        found.append(np.concatenate([x, y], axis=1))
    return np.array(found)
