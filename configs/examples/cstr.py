"""Exothermic stirred tank reactor; time in minutes, concentrations in mol/l, temperatures in K."""

import numpy as np


def rhs(x, u, p):
    """Return d/dt of (CA, T) [1/min] for the coolant temperature u = (Tc,)."""
    r = p.k0 * np.exp(-8750 / x[1]) * x[0]
    return [1 - x[0] - r, 350 - x[1] + 209.2 * r + p.cooling * (u[0] - x[1])]


def output(x, p):
    """Measure the temperature."""
    return [x[1]]
