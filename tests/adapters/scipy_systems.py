"""A system of scipy.signal, and a simulation of one run without noise."""

import numpy as np
from scipy import signal


def oscillator(m=1.0, k=2.0, d=0.3):
    """A mass with a spring and a damper."""
    return signal.StateSpace([[0.0, 1.0], [-k / m, -d / m]], [[0.0], [1.0 / m]], [[1.0, 0.0]], [[0.0]])


def trajectory(plant, u):
    """Return the outputs (steps, ny) for inputs (steps, nu) from x = 0, with nominal parameters."""
    columns = {name: np.array([value]) for name, value in plant.nominal.items()}
    delta, x, y = plant.draw(columns, [np.random.default_rng(0)], len(u)), np.zeros((1, plant.nx)), []
    for k, each in enumerate(u):
        y.append(plant.output(k, delta, x, np.zeros((1, plant.nv)))[0])
        x = plant.step(k, delta, x, each[None], np.zeros((1, plant.nw))).x
    return np.array(y)
