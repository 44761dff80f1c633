"""A pendulum on a cart as a user would write it, and its linearisation in closed form; used by several tests.

States: position s of the cart, angle a from the upright position, and their rates; input: force on the cart.
"""

import math

import numpy as np

PARAMETERS = {"M": 0.5, "m": 0.2, "length": 0.3, "friction": 0.1}
STATES, INPUTS = ["s", "a", "v", "w"], {"force": "N"}
G = 9.81


def rhs(x, u, p):
    """Time derivatives."""
    sin, cos = np.sin(x[1]), np.cos(x[1])
    force = u[0] - p.friction * x[2]
    v = (force + p.m * sin * (p.length * x[3] ** 2 - G * cos)) / (p.M + p.m * sin**2)
    return [x[2], x[3], v, (G * sin - cos * v) / p.length]


def position(x, p):
    """The position of the cart is measured."""
    return [x[0]]


def linear(p, *, upright):
    """A and B at an equilibrium: upright, or hanging."""
    side = 1.0 if upright else -1.0
    M, m, length, friction = p["M"], p["m"], p["length"], p["friction"]
    A = np.zeros((4, 4))
    A[0, 2] = A[1, 3] = 1.0
    A[2] = [0.0, -m * G / M, -friction / M, 0.0]
    A[3] = [0.0, side * (M + m) * G / (M * length), side * friction / (M * length), 0.0]
    return A, np.array([[0.0], [0.0], [1.0 / M], [-side / (M * length)]])


def table(x, u, p):
    """A rhs with a kink at x = 1, for a single run at a time."""
    return [math.sin(float(u[0])) - np.interp(x[0], [0.0, 1.0, 2.0], [0.0, 1.0, 5.0])]
