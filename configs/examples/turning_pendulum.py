"""Pendulum with a driving torque and a load torque; angle theta from the lower rest position."""

import numpy as np


def rhs(x, u, p):
    """Return d/dt of (theta, omega) for u = (torque, load)."""
    return [x[1], -9.81 * np.sin(x[0]) - 0.5 * x[1] + u[0] + u[1]]


def output(x, p):
    """Measure the angle in (-pi, pi]."""
    return [np.arctan2(np.sin(x[0]), np.cos(x[0]))]


def camera_and_gyroscope(x, p):
    """Measure the angle in (-pi, pi], and its rate."""
    return [np.arctan2(np.sin(x[0]), np.cos(x[0])), x[1]]
