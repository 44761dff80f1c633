"""Friction characteristics of the servomechanism as plot records: (20) and (21) of zenere2018, its Fig. 2.

While a body slips, the torque is T_f(w) = (alpha_0 + alpha_1 exp(-alpha_2 |w|)) sgn(w).  At w = 0 it takes the value of
the interval between the two limits that keeps the body at rest.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, Line, Panel

POINTS = 200
BODIES = (("l", "load", r"\ell"), ("m", "motor", "m"))


def friction_torque(w: Float[Array, " points"], a0: float, a1: float, a2: float) -> Float[Array, " points"]:
    """Friction torque of a slipping body [N m].

    Parameters
    ----------
    w : angular velocity [rad/s]; 0 counts as positive
    a0, a1, a2 : friction parameters [N m, N m, s/rad]
    """
    return (a0 + a1 * np.exp(-a2 * np.abs(w))) * np.where(w < 0.0, -1.0, 1.0)  # (20), (21)


def friction_profile(name: str, index: str, alpha: tuple[float, float, float]) -> Panel:
    """Plot record of the friction of one body.

    Parameters
    ----------
    name : name of the body
    index : index of the body in formulas
    alpha : friction parameters alpha_0, alpha_1 [N m] and alpha_2 [s/rad]
    """
    a0, a1, a2 = alpha
    # exp(-a2 w) is below 1 % at the end of the axis.
    fastest = 5.0 / a2 if a2 > 0.0 and a1 > 0.0 else 1.0
    w = np.linspace(0.0, fastest, POINTS)
    T = friction_torque(w, a0, a1, a2)
    limit = a0 + a1
    slipping = Line("slipping", np.concatenate([-w[::-1], [0.0], w]), np.concatenate([-T[::-1], [np.nan], T]))
    at_rest = Line("at rest", np.zeros(2), np.array([-limit, limit]))
    title = rf"{name}: sticks up to {limit:g} N m"
    return Panel(title, rf"$\dot{{\theta}}_{index}$ [rad/s]", rf"$T_{{f_{index}}}$ [N m]", (slipping, at_rest))


def friction_profiles(nominal: Mapping[str, float]) -> tuple[Panel, ...]:
    """Plot records of the friction of load and motor.

    Parameters
    ----------
    nominal : parameters of the plant, including those of its friction
    """
    return tuple(
        friction_profile(name, index, (nominal[f"alpha_{b}0"], nominal[f"alpha_{b}1"], nominal[f"alpha_{b}2"]))
        for b, name, index in BODIES
    )
