"""Components of angles.yaml: a pendulum whose angle is measured in (-pi, pi]."""

import numpy as np


def rhs(x, u, p):
    """Return d/dt of (theta, omega) for a torque; theta is the angle from the lower rest position."""
    return [x[1], -9.81 * np.sin(x[0]) - 0.5 * x[1] + u[0]]


def output(x, p):
    """Measure the angle in (-pi, pi]."""
    return [np.arctan2(np.sin(x[0]), np.cos(x[0]))]
