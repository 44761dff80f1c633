"""The servomechanism as it is taken to be in truth: armature inductance and dry friction on load and motor.

Model   as in models/servo.py with L > 0 and T_f(w) = (alpha_0 + alpha_1 exp(-alpha_2 |w|)) sgn(w) on both bodies.
        At w = 0 the friction is the whole interval [-(alpha_0 + alpha_1), alpha_0 + alpha_1] (Filippov): a body sticks
        as long as some torque of the interval holds it, and its velocity is then exactly zero.
        State x = [th_l, w_l, th_m, w_m, I]: the linear model's four and the armature current [A].
Source  zenere2018, section 4.1, (20), (21), Tables 1 and 2.
Chosen  process noise kicks the first four states at the end of a sample; integration with `substep`: the linear part by
        its exact exponential, the friction as an impulse that is implicit in the end velocity (first order).
Cost    about 0.05 us per run and substep (`make perf`: 0.23 ms for 50 runs of 100 substeps).
Fails   status `out-of-range` where a drawn inertia, resistance, inductance or gear ratio is not positive, another
        parameter is negative, or the substep is too coarse for them; inductances below about 1e-12 H lose digits in the
        matrix exponential.

`servo-linear`, the model without dry friction and inductance, is a plant here too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.models.servo import MUST_BE_POSITIVE, TABLE_1, continuous
from rmpc_bench.numerics.linalg import discretise, mv
from rmpc_bench.types import Array, DesignError, Motion, NonNegative, Positive, Status, Statuses

MOST_SUBSTEPS = 100_000
FRICTION = ("alpha_l0", "alpha_l1", "alpha_l2", "alpha_m0", "alpha_m1", "alpha_m2")


class LinearDelta(NamedTuple):
    """Sampled dynamics of every run: x(k+1) = E x(k) + G inputs."""

    E: Float[Array, "runs nx nx"]
    G: Float[Array, "runs nx inputs"]
    status: Statuses


class ServoDelta(NamedTuple):
    """Dynamics of every run over a substep; the inputs of ``G`` are the voltage and the two friction torques."""

    E: Float[Array, "runs 5 5"]
    G: Float[Array, "runs 5 3"]
    alpha: Float[Array, "runs 6"]
    status: Statuses


def with_current(p: Mapping[str, float]) -> tuple[Float[Array, "5 5"], Float[Array, "5 3"]]:
    """Continuous-time matrices of the linear part with inductance; inputs [V, T_fl, T_fm]."""
    A, B = np.zeros((5, 5)), np.zeros((5, 3))
    A[:4, :4] = continuous(p)[0]
    A[3, 3] = -p["beta_m"] / p["J_m"]
    A[3, 4] = p["K_t"] / p["J_m"]
    A[4, 3], A[4, 4] = -p["K_t"] / p["L"], -p["R"] / p["L"]
    B[4, 0], B[1, 1], B[3, 2] = 1.0 / p["L"], -1.0 / p["J_l"], -1.0 / p["J_m"]
    return A, B


def _admissible(parameters: Mapping[str, Float[Array, " runs"]]) -> Float[Array, " runs"]:
    """Return 1 for runs whose parameters mean something, 0 for the others."""
    good = np.ones(len(next(iter(parameters.values()))))
    for name, values in parameters.items():
        positive = name in MUST_BE_POSITIVE or name == "L"
        good *= np.isfinite(values) & ((values > 0.0) if positive else (values >= 0.0))
    return good


def _rows(
    parameters: Mapping[str, Float[Array, " runs"]], nominal: Mapping[str, float]
) -> tuple[list[dict[str, float]], Statuses]:
    """Split the parameters into one record per run; a run without meaning gets the nominal ones and a status."""
    good = _admissible(parameters)
    rows = [
        {name: float(values[i]) for name, values in parameters.items()} if good[i] else dict(nominal)
        for i in range(len(good))
    ]
    return rows, np.where(good == 1.0, Status.OK, Status.OUT_OF_RANGE).astype(np.int8)


def _friction_brakes(G: Float[Array, "runs 5 3"]) -> Bool[Array, " runs"]:
    """Whether friction lowers the velocities at the end of a substep: -G there must be a P-matrix.

    A substep as long as a period of the shaft's oscillation lets a torque at its start push at its end, and the
    implicit scheme then has no meaning.
    """
    W = -G[:, [1, 3]][:, :, 1:]
    braking = (W[:, 0, 0] > 0.0) & (W[:, 1, 1] > 0.0) & (np.linalg.det(W) > 0.0)
    return np.asarray(braking)


@dataclass(frozen=True, eq=False)
class Servo:
    """The nonlinear servomechanism; build it with `design`."""

    Ts: float
    nominal: Mapping[str, float]
    n_substeps: int
    nx: int = field(default=5, init=False)
    nu: int = field(default=1, init=False)
    ny: int = field(default=1, init=False)
    nw: int = field(default=4, init=False)
    nv: int = field(default=1, init=False)
    y_unit: str = field(default="rad", init=False)
    u_unit: str = field(default="V", init=False)

    def draw(
        self, parameters: Mapping[str, Float[Array, " runs"]], rngs: Sequence[np.random.Generator], n_steps: int
    ) -> ServoDelta:
        """Sample the linear part of every run over a substep."""
        rows, status = _rows(parameters, self.nominal)
        sampled = [discretise(*with_current(p), self.Ts / self.n_substeps) for p in rows]
        G = np.stack([G for _, G in sampled])
        return ServoDelta(
            E=np.stack([E for E, _ in sampled]),
            G=G,
            alpha=np.array([[p[name] for name in FRICTION] for p in rows]),
            status=np.where(_friction_brakes(G), status, Status.OUT_OF_RANGE).astype(np.int8),
        )

    def step(
        self,
        k: int,
        delta: ServoDelta,
        x: Float[Array, "runs 5"],
        u: Float[Array, "runs 1"],
        w: Float[Array, "runs 4"],
    ) -> Motion:
        """Move over one sample with the voltage held, then add the process noise."""
        from rmpc_bench.plants.servo_kernel import servo_step_kernel

        x_next = servo_step_kernel(x, u, delta.E, delta.G, delta.alpha, self.n_substeps)
        x_next[:, :4] += w
        return Motion(x_next, delta.status)

    def output(
        self, k: int, delta: ServoDelta, x: Float[Array, "runs 5"], v: Float[Array, "runs 1"]
    ) -> Float[Array, "runs 1"]:
        """Measure the load angle."""
        return x[:, :1] + v

    def warm_up(self) -> None:
        """Compile the kernel (or load it from the cache) by moving one run over one sample."""
        one = {name: np.array([value]) for name, value in self.nominal.items()}
        delta = self.draw(one, [], 1)
        self.step(0, delta, np.zeros((1, 5)), np.zeros((1, 1)), np.zeros((1, 4)))


@dataclass(frozen=True, eq=False)
class ServoLinear:
    """The linear servomechanism as a plant; build it with `design_linear`."""

    Ts: float
    nominal: Mapping[str, float]
    nx: int = field(default=4, init=False)
    nu: int = field(default=1, init=False)
    ny: int = field(default=1, init=False)
    nw: int = field(default=4, init=False)
    nv: int = field(default=1, init=False)
    y_unit: str = field(default="rad", init=False)
    u_unit: str = field(default="V", init=False)

    def draw(
        self, parameters: Mapping[str, Float[Array, " runs"]], rngs: Sequence[np.random.Generator], n_steps: int
    ) -> LinearDelta:
        """Sample the dynamics of every run."""
        rows, status = _rows(parameters, self.nominal)
        sampled = [discretise(*continuous(p), self.Ts) for p in rows]
        return LinearDelta(np.stack([E for E, _ in sampled]), np.stack([G for _, G in sampled]), status)

    def step(
        self,
        k: int,
        delta: LinearDelta,
        x: Float[Array, "runs 4"],
        u: Float[Array, "runs 1"],
        w: Float[Array, "runs 4"],
    ) -> Motion:
        """Move over one sample with the voltage held, then add the process noise."""
        return Motion(mv(delta.E, x) + mv(delta.G, u) + w, delta.status)

    def output(
        self, k: int, delta: LinearDelta, x: Float[Array, "runs 4"], v: Float[Array, "runs 1"]
    ) -> Float[Array, "runs 1"]:
        """Measure the load angle."""
        return x[:, :1] + v


def design(
    Ts: float,
    *,
    L: Positive = 0.8,
    J_m: Positive = TABLE_1["J_m"],
    beta_m: NonNegative = TABLE_1["beta_m"],
    R: Positive = TABLE_1["R"],
    K_t: Positive = TABLE_1["K_t"],
    rho: Positive = TABLE_1["rho"],
    k_theta: Positive = TABLE_1["k_theta"],
    J_l: Positive = TABLE_1["J_l"],
    beta_l: NonNegative = TABLE_1["beta_l"],
    alpha_l0: NonNegative = 0.5,
    alpha_l1: NonNegative = 10.0,
    alpha_l2: NonNegative = 0.5,
    alpha_m0: NonNegative = 0.1,
    alpha_m1: NonNegative = 2.0,
    alpha_m2: NonNegative = 0.5,
    substep: Positive = 1e-3,
) -> Servo:
    """Nonlinear servomechanism; `perturb` and `set` act on the parameters given here.

    Parameters
    ----------
    Ts : sampling time [s]
    L : armature inductance [H]
    J_m : motor inertia [kg m^2]
    beta_m : viscous friction of the motor [N m s]
    R : armature resistance [Ohm]
    K_t : motor constant [N m/A]
    rho : gear ratio
    k_theta : torsional rigidity [N m/rad]
    J_l : load inertia [kg m^2]
    beta_l : viscous friction of the load [N m s]
    alpha_l0 : Coulomb friction of the load [N m]
    alpha_l1 : additional friction of the load near standstill [N m]
    alpha_l2 : its decay with the velocity [s/rad]
    alpha_m0 : Coulomb friction of the motor [N m]
    alpha_m1 : additional friction of the motor near standstill [N m]
    alpha_m2 : its decay with the velocity [s/rad]
    substep : longest integration step [s]

    Raises
    ------
    DesignError
        If the substep is so long that the friction scheme has no meaning.
    """
    given = locals()
    nominal = {name: float(given[name]) for name in ("L", *TABLE_1, *FRICTION)}
    if Ts / substep > MOST_SUBSTEPS:
        raise DesignError(f"must be at least Ts / {MOST_SUBSTEPS:,}", "substep")
    plant = Servo(Ts, nominal, ceil(Ts / substep * (1.0 - 1e-12)))
    if plant.draw({name: np.array([value]) for name, value in nominal.items()}, [], 1).status[0] != Status.OK:
        raise DesignError("too coarse for these parameters: friction would push instead of brake", "substep")
    return plant


def design_linear(
    Ts: float,
    *,
    J_m: Positive = TABLE_1["J_m"],
    beta_m: NonNegative = TABLE_1["beta_m"],
    R: Positive = TABLE_1["R"],
    K_t: Positive = TABLE_1["K_t"],
    rho: Positive = TABLE_1["rho"],
    k_theta: Positive = TABLE_1["k_theta"],
    J_l: Positive = TABLE_1["J_l"],
    beta_l: NonNegative = TABLE_1["beta_l"],
) -> ServoLinear:
    """Linear servomechanism as a plant: no inductance, no dry friction.

    Parameters
    ----------
    Ts : sampling time [s]
    J_m : motor inertia [kg m^2]
    beta_m : viscous friction of the motor [N m s]
    R : armature resistance [Ohm]
    K_t : motor constant [N m/A]
    rho : gear ratio
    k_theta : torsional rigidity [N m/rad]
    J_l : load inertia [kg m^2]
    beta_l : viscous friction of the load [N m s]
    """
    given = locals()
    return ServoLinear(Ts, {name: float(given[name]) for name in TABLE_1})
