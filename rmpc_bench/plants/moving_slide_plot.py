"""Top view of the parallel robot at the start and at half time of the S-shaped reference: Fig. 1 of belda2017."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.moving_slide import CORNERS, arms
from rmpc_bench.numerics.s_shape import DURATION, s_curve
from rmpc_bench.types import Array, Line, Panel

POINTS = 400


def robot_at(y: Float[Array, " 3"], a: float, b: float) -> tuple[Float[Array, " points"], Float[Array, " points"]]:
    """Outline of the arms and of the platform, separated by NaN.

    Parameters
    ----------
    y : (3,) position [m] and angle [rad] of the platform
    a, b : half sides of the squares of the base joints and of the platform [m]

    Returns
    -------
    tuple
        Horizontal and vertical coordinates [m].
    """
    joints = arms(y[None], a, b).joints[0]
    gap = np.full((1, 2), np.nan)
    pieces = [piece for base, joint in zip(a * CORNERS, joints, strict=True) for piece in ([base, joint], gap)]
    outline = np.concatenate([*pieces, joints, joints[:1]])
    return outline[:, 0], outline[:, 1]


def robot_on_its_path(a: float, b: float) -> tuple[Panel, Panel]:
    """Plot records of the robot at the start and at half time, and of the reference with a mark at every second.

    Parameters
    ----------
    a, b : half sides of the squares of the base joints and of the platform [m]
    """
    t, half = np.linspace(0.0, DURATION, POINTS), DURATION / 2
    path, seconds = s_curve(t), np.arange(DURATION + 1.0)
    marks, base = s_curve(seconds), a * CORNERS
    centre = Line("path of the centre", path[:, 0], path[:, 1])
    robot = (
        centre,
        Line("the robot at 0 s", *robot_at(path[0], a, b)),
        Line(f"at {half:g} s", *robot_at(s_curve(np.array([half]))[0], a, b)),
        Line("base joints", base[:, 0], base[:, 1], dots=True, notes=tuple(f"$A_{i}$" for i in (1, 2, 3, 4))),
    )
    timed = Line("every second", marks[:, 0], marks[:, 1], dots=True, notes=tuple(f"{each:g}" for each in seconds))
    axes = ("$x_c$ [m]", "$y_c$ [m]")
    return (
        Panel("four driven arms and the platform", *axes, robot, equal=True),
        Panel("the S, with the time [s]", *axes, (centre, timed), equal=True),
    )
