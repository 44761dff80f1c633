"""Three reactors for estimators of nonlinear models: two with unmeasured, nonnegative states, and a stirred tank."""

import numpy as np


def three(x, u, p):
    """A = B + C and 2 B = C."""
    r1, r2 = 0.5 * x[0] - 0.05 * x[1] * x[2], 0.2 * x[1] * x[1] - 0.01 * x[2]
    return [-r1, r1 - 2 * r2, r1 + r2]


def pressure(x, p):
    """The sum of all partial pressures."""
    return [32.84 * (x[0] + x[1] + x[2])]


def two(x, u, p):
    """2 A = B."""
    r = 0.16 * x[0] * x[0] - 0.0064 * x[1]
    return [-2 * r, r]


def total(x, p):
    """The sum of both."""
    return [x[0] + x[1]]


def cstr(x, u, p):
    """An exothermic reaction in a stirred tank."""
    r = 7.2e10 * np.exp(-8750 / x[1]) * x[0]
    return [1 - x[0] - r, 350 - x[1] + 5e4 / 239 * r + 5e4 / 23900 * (u[0] - x[1])]


def temperature(x, p):
    """The temperature."""
    return [x[1]]
