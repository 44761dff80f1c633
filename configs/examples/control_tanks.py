"""The system of control.yaml: two tanks in series, as a system of python-control.

Plant   A pump with flow u [ml/s] fills the first tank, whose orifice empties into the second one.  With the cross
        section A of the tanks and the orifices a_i, Torricelli's law v = sqrt(2 g h) gives
            A h1' = u - a1 sqrt(2 g h1),   A h2' = a1 sqrt(2 g h1) - a2 sqrt(2 g h2).
        The values are those of tanks.py.
"""

import control
import numpy as np

GRAVITY = 9.81  # m/s^2


def update(t, x, u, params):
    """Return dx/dt: x = (h1, h2) levels [m], u = (pump,) flow into the first tank [ml/s]."""
    q1 = params["a1"] * np.sqrt(2 * GRAVITY * x[0])  # m^3/s
    q2 = params["a2"] * np.sqrt(2 * GRAVITY * x[1])
    return [(1e-6 * u[0] - q1) / params["area"], (q1 - q2) / params["area"]]


def level(t, x, u, params):
    """Return what is measured: the level of the second tank [m]."""
    return [x[1]]


# `params` are the parameters of the plant, with their nominal values.
tanks = control.nlsys(
    update,
    level,
    states=["h1", "h2"],
    inputs=["pump"],
    outputs=["level"],
    params={"a1": 7.1e-6, "a2": 5.7e-6, "area": 2.8e-3},
    name="tanks",
)
