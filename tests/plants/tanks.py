"""Two tanks in series as a user would write them, and their closed forms; used by several tests.

h1' = (k q - a1 sqrt(2 g h1)) / S1,  h2' = (a1 sqrt(2 g h1) - a2 sqrt(2 g h2)) / S2, with q in ml/s.
"""

import numpy as np

S1 = S2 = 4e-3
G = 9.81
PARAMETERS = {"a1": 7.1e-6, "a2": 6.3e-6, "k": 1.0}
STATES, INPUTS, OUTPUTS = {"h1": "m", "h2": "m"}, {"pump": "ml/s"}, {"level": "m"}


def rhs(x, u, p):
    """Time derivatives of the levels."""
    q1, q2 = p.a1 * np.sqrt(2 * G * x[0]), p["a2"] * np.sqrt(2 * G * x[1])
    return [(p.k * 1e-6 * u[0] - q1) / S1, (q1 - q2) / S2]


def output(x, p):
    """The lower level."""
    return [x[1]]


def steady_state(u, p):
    """Levels at which nothing changes: h = (k u / a)^2 / (2 g)."""
    return [(p["k"] * 1e-6 * u / p[name]) ** 2 / (2 * G) for name in ("a1", "a2")]
