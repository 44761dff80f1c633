"""Parallel robot as a plant, integrated by the Runge-Kutta method of order 4, and the poses that end a run.

Model   M(y) v' + N(y, v) v = J' tau with a zero-order hold of the torques.  The process noise w is added to the state
        x = [x_c, y_c, psi, and their velocities] at the end of the sample; y = (x_c, y_c, psi) + v.
Source  belda2017, section VI, (29); the experiment has measurement noise only.
Assumed All parameter values, as the paper prints none; two integration steps per sample, with an error of about 1e-12 m
        at a sampling time of 0.01 s.
Cost    2.2 us per run and sample of two steps.
Fails   Status `out-of-range`: a drawn mass, inertia or length is not positive, a damping is negative, or an arm is
        longer than `arm` or shorter than `l_min`.  Status `singular`: the smallest singular value of J is below 0.02,
        so that the torques cannot move the platform in every direction; in the centre this happens at
        |psi| = acos(b/a) = 74.5 degrees.  Status `diverged`: the state is not finite, or |x_c| or |y_c| exceeds 1 m.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.moving_slide import CORNERS, PARAMETERS, arms, kernel_numbers
from rmpc_bench.numerics.linalg import as_compiled
from rmpc_bench.numerics.s_shape import DURATION, s_curve
from rmpc_bench.types import Array, Count, DesignError, Line, Motion, Panel, Plant, Positive, Status, Statuses
from rmpc_bench.types.basics import Keyword, takes, values_of
from rmpc_bench.types.plant import Generators, Inputs, InputSteps, Noises, Outputs, ParameterValues, States, StateSteps

LEAST_SIGMA = 0.02
"""A pose counts as singular if the smallest singular value of J is below this; the kernel has its own copy."""
MAY_BE_ZERO = ("d_rot", "d_sl")
UNITS = {"y.0": "m", "y.1": "m", "y.2": "rad", "x.0": "m", "x.1": "m", "x.2": "rad"}
UNITS |= {"x.3": "m/s", "x.4": "m/s", "x.5": "rad/s"}


class SlideDelta(NamedTuple):
    """Parameters of every run in the order of the kernel; shortest and longest arm are the last two."""

    numbers: Float[Array, "runs 10"]
    status: Statuses


@dataclass(frozen=True, eq=False)
class MovingSlide(Plant):
    """The parallel robot; build it with `design`."""

    Ts: float
    nominal: Mapping[str, float]
    substeps: int

    nx, nu, ny = 6, 4, 3
    u_unit, units = "N m", UNITS
    has_singular_poses = has_between = True

    def draw(self, parameters: ParameterValues, rngs: Generators, n_steps: int) -> SlideDelta:
        """Return the parameters of every run; a run with invalid parameters gets the nominal ones and a status."""
        good = np.ones(len(next(iter(parameters.values()))), dtype=bool)
        for name, values in parameters.items():
            good &= np.isfinite(values) & ((values >= 0.0) if name in MAY_BE_ZERO else (values > 0.0))
        rows = [{name: float(values[i]) for name, values in parameters.items()} for i in range(len(good))]
        numbers = [_numbers(p if fine else self.nominal) for p, fine in zip(rows, good, strict=True)]
        return SlideDelta(np.stack(numbers), np.where(good, Status.OK, Status.OUT_OF_RANGE).astype(np.int8))

    def step(self, k: int, delta: SlideDelta, x: States, u: Inputs, w: Noises) -> Motion:
        """Advance one sample with constant torques, then add the process noise."""
        from rmpc_bench.models.moving_slide_kernel import slide_step_kernel

        x, u, w = map(as_compiled, (x, u, w))
        x_next, status = slide_step_kernel(x, u, w, delta.numbers, self.Ts, self.substeps)
        return Motion(x_next, np.where(delta.status != Status.OK, delta.status, status))

    def output(self, k: int, delta: SlideDelta, x: States, v: Noises) -> Outputs:
        """Measure the pose."""
        return x[:, :3] + v

    def between(
        self, delta: SlideDelta, x: StateSteps, u: InputSteps, parts: int, first: int = 0
    ) -> Float[Array, "runs steps parts nx"]:
        """Integrate every period in equal parts, each with as many steps as the plant takes for a period."""
        from rmpc_bench.models.moving_slide_kernel import slide_step_kernel

        states, no_noise = np.empty((*x.shape[:2], parts, self.nx)), np.zeros((len(x), self.nx))
        for k in range(x.shape[1]):
            now, torques = as_compiled(x[:, k]), as_compiled(u[:, k])
            for part in range(parts):
                now, _ = slide_step_kernel(now, torques, no_noise, delta.numbers, self.Ts / parts, self.substeps)
                states[:, k, part] = now
        return states

    def manipulability(self, y: Float[Array, "poses 3"]) -> Float[Array, " poses"]:
        """Smallest singular value of J of the nominal robot."""
        from rmpc_bench.models.moving_slide_kernel import sigma_kernel

        return np.asarray(sigma_kernel(as_compiled(y), _numbers(self.nominal)))

    def unreachable(self, r: Float[Array, "samples 3"]) -> str | None:
        """Describe where a reference is out of reach of the nominal robot or singular; None if it is neither."""
        p = self.nominal
        _, lengths, J = arms(r, p["a"], p["b"])
        outside = (lengths < p["l_min"]) | (lengths > p["arm"])
        reached = int(np.argmax(outside.any(axis=1))) if outside.any() else len(r)
        sigma = np.linalg.svd(J[:reached], compute_uv=False)[:, -1]
        if (sigma < LEAST_SIGMA).any():
            k = int(np.argmax(sigma < LEAST_SIGMA))
            pose = ", ".join(f"{value:.4g}" for value in r[k])
            return (
                f"at {k * self.Ts:g} s the pose ({pose}) is singular: the torques cannot move the platform in every "
                f"direction (smallest singular value of J {sigma[k]:.2g}, below {LEAST_SIGMA:g}); reduce the angle"
            )
        if reached == len(r):
            return None
        arm = int(np.argmax(outside[reached]))
        return (
            f"at {reached * self.Ts:g} s arm {arm + 1} would be {lengths[reached, arm]:.4g} m long; its range is "
            f"{p['l_min']:g} to {p['arm']:g} m: stay closer to the centre"
        )

    @property
    def cost_per_step(self) -> float:
        """Mostly that of the integration [s]."""
        return 1.1e-6 * self.substeps

    def plots(self) -> tuple[Panel, ...]:
        """Draw the robot and the S that the paper's platform follows."""
        return robot_on_its_path(self.nominal["a"], self.nominal["b"])

    def warm_up(self) -> None:
        """Compile the kernel (or load it from the cache) by simulating one sample of one run."""
        one = {name: np.array([value]) for name, value in self.nominal.items()}
        x = np.zeros((1, 6))
        self.step(0, self.draw(one, [], 1), x, np.zeros((1, 4)), x)
        self.manipulability(x[:, :3])


def _numbers(p: Mapping[str, float]) -> Float[Array, " 10"]:
    return np.append(kernel_numbers(p), [p["l_min"], p["arm"]])


ALL = {
    **PARAMETERS,
    "arm": Keyword(Positive, 0.50, "length of an arm and largest distance of its slide from the base joint [m]"),
    "l_min": Keyword(Positive, 0.05, "smallest distance of a slide from the base joint [m]"),
}


@takes(ALL)
def design(Ts: float, *, substeps: Count = 2, **parameters: float) -> MovingSlide:
    """Parallel robot; `perturb` and `set` accept all keys but `substeps`.

    Parameters
    ----------
    Ts : sampling time [s]
    substeps : Runge-Kutta steps per sample
    parameters : those of the robot

    Raises
    ------
    DesignError
        If l_min is not below the length of an arm.
    """
    nominal = values_of(ALL, parameters)
    arm, l_min = nominal["arm"], nominal["l_min"]
    if l_min >= arm:
        raise DesignError(f"must be below the length of an arm, {arm:g} m (got {l_min:g})", "l_min")
    return MovingSlide(Ts, nominal, substeps)


POINTS = 400


def robot_at(y: Float[Array, " 3"], a: float, b: float) -> tuple[Float[Array, " points"], Float[Array, " points"]]:
    """Outline of the arms and of the platform at a pose [m, m, rad], separated by NaN: horizontal and vertical [m].

    `a` and `b` are the half sides of the squares of the base joints and of the platform [m].
    """
    joints = arms(y[None], a, b).joints[0]
    gap = np.full((1, 2), np.nan)
    pieces = [piece for base, joint in zip(a * CORNERS, joints, strict=True) for piece in ([base, joint], gap)]
    outline = np.concatenate([*pieces, joints, joints[:1]])
    return outline[:, 0], outline[:, 1]


def robot_on_its_path(a: float, b: float) -> tuple[Panel, Panel]:
    """Plot records of the robot at start and half time, and of the reference with a mark every second; a, b [m]."""
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
