"""Nonlinear servomechanism with armature inductance and dry friction on load and motor; the linear one has neither.

Model   `servo`  As in models/servo.py with L > 0 and T_f(w) = (alpha_0 + alpha_1 exp(-alpha_2 |w|)) sgn(w) on both
                 bodies.  At w = 0 the friction torque is the interval [-(alpha_0 + alpha_1), alpha_0 + alpha_1]
                 (Filippov): a body sticks, with velocity exactly zero, as long as a torque of it balances the others. x
                 = [th_l, w_l, th_m, w_m, I], with the armature current I [A].
        `servo-linear`  As in models/servo.py.
Source  zenere2018, section 4.1, (20), (21), Tables 1 and 2.
Assumed Process noise is added to the four states of the linear model at the end of a sample.
        `servo`  Stick or slip follows from the state alone at the start of a sample.  Taylor series between friction
                 events (models/servo_kernel.py) leave rounding errors only, 1e-14 rad in the load angle of Fig. 7.
Cost    `servo`  1.0 us per run and sample of 0.1 s in Fig. 7 (`pytest -m perf tests/perf/test_servo_cost.py`); 0.27 ms
                 with L = 1e-3 H.
Fails   Status `out-of-range`: a drawn inertia, resistance, inductance or gear ratio is not positive, another parameter
        is negative, or |eigenvalue| Ts of the linear part exceeds 20,000.
        `servo`  Status `too-many-events`: friction stops and releases a body more than 1000 times in a sample, or a
                 sample needs more than 20,000 series.  Such a sample costs up to 60 ms (seconds with alpha_2 > 1e50).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.models.servo import (
    LINEAR,
    MUST_BE_POSITIVE,
    NONLINEAR,
    TORQUE_UNITS,
    coefficients,
    continuous,
    nonlinear_parameters,
    shaft_torque,
    slow_enough,
    surely_slow_enough,
    with_current,
)
from rmpc_bench.numerics.linalg import discretise, mv
from rmpc_bench.types import Array, CompiledPlant, Line, LinearPlant, Motion, Panel, Plant, Status, Statuses, Term
from rmpc_bench.types.basics import takes, values_of
from rmpc_bench.types.plant import Generators, Inputs, InputSteps, Noises, Outputs, ParameterValues, States, StateSteps

POINTS = 200
BODIES = (("l", "load", r"\ell"), ("m", "motor", "m"))


def friction_torque(w: Float[Array, " points"], a0: float, a1: float, a2: float) -> Float[Array, " points"]:
    """Friction torque of a slipping body [N m] with a0, a1 [N m] and a2 [s/rad]; w = 0 [rad/s] counts as positive."""
    return (a0 + a1 * np.exp(-a2 * np.abs(w))) * np.where(w < 0.0, -1.0, 1.0)  # (20), (21)


def friction_profile(name: str, index: str, alpha: tuple[float, float, float]) -> Panel:
    """Plot record of the friction of one body."""
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
    """Plot records of the friction of load and motor: (20) and (21) of zenere2018, its Fig. 2."""
    return tuple(
        friction_profile(name, index, (nominal[f"alpha_{b}0"], nominal[f"alpha_{b}1"], nominal[f"alpha_{b}2"]))
        for b, name, index in BODIES
    )


def admissible(parameters: Mapping[str, Float[Array, " runs"]]) -> Bool[Array, " runs"]:
    """Whether the parameters of each run are valid: divisors are positive, no parameter is negative."""
    good = np.ones(len(next(iter(parameters.values()))), dtype=bool)
    for name, values in parameters.items():
        positive = name in (*MUST_BE_POSITIVE, "L")
        good &= np.isfinite(values) & ((values > 0.0) if positive else (values >= 0.0))
    return good


def linear_part(
    continuous: Callable[[Mapping[str, float]], tuple[Array, Array]], parameters: Mapping[str, float], Ts: float
) -> LinearPlant | None:
    """Sample the linear part with a zero-order hold of the voltage.

    The first four states are those of the model; the fifth, the armature current, is not part of it.
    None if a parameter is out of range.
    """
    if not admissible({name: np.array([value]) for name, value in parameters.items()})[0]:
        return None
    A, B = discretise(*continuous(parameters), Ts)
    return LinearPlant(A, B[:, :1], np.eye(1, len(A)), np.eye(4, len(A)))


def linear_between(
    E: Float[Array, "runs nx nx"], G: Float[Array, "runs nx nu"], x: StateSteps, u: InputSteps, parts: int
) -> Float[Array, "runs steps parts nx"]:
    """Return the states at the ends of equal parts of every control period."""
    states = np.empty((*x.shape[:2], parts, x.shape[2]))
    for k in range(x.shape[1]):
        now, driven = x[:, k], mv(G, u[:, k])
        for part in range(parts):
            now = mv(E, now) + driven
            states[:, k, part] = now
    return states


class LinearDelta(NamedTuple):
    """Sampled dynamics of every run: x(k+1) = E x(k) + G u(k)."""

    E: Float[Array, "runs nx nx"]
    G: Float[Array, "runs nx inputs"]
    status: Statuses
    parameters: Mapping[str, Float[Array, " runs"]]
    """Parameters of every run; the nominal ones where those drawn are out of range."""


class ServoDelta(NamedTuple):
    """What differs from run to run."""

    coefficients: Float[Array, "runs 3 9"]
    status: Statuses
    k_theta: Float[Array, " runs"]  # torsional rigidity of the shaft [N m/rad]
    rho: Float[Array, " runs"]  # gear ratio


@dataclass(frozen=True, eq=False)
class ServoPlant(Plant):
    """What both servomechanisms have in common: a voltage, the load angle, noise on the linear states."""

    Ts: float
    nominal: Mapping[str, float]

    nu = ny = nv = 1
    nw = 4
    y_unit, u_unit = "rad", "V"
    extra_signals = TORQUE_UNITS
    has_between = has_compiled_form = True

    def output(self, k: int, delta: Any, x: States, v: Noises) -> Outputs:
        """Measure the load angle."""
        return x[:, :1] + v


@dataclass(frozen=True, eq=False)
class Servo(ServoPlant):
    """The nonlinear servomechanism; create it with `design`."""

    nx = 5

    def draw(self, parameters: ParameterValues, rngs: Generators, n_steps: int) -> ServoDelta:
        """Return the coefficients of every run."""
        good = admissible(parameters)
        p = {name: np.where(good, values, self.nominal[name]) for name, values in parameters.items()}
        # Extreme parameters may overflow; such a run is out of range.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            found = coefficients(p)
            slow = surely_slow_enough(found[:, 0], self.Ts)
        # Eigenvalues of the few runs that are close to the limit or beyond it.
        doubtful = np.flatnonzero(~slow)
        slow[doubtful] = slow_enough([{name: float(p[name][i]) for name in p} for i in doubtful], self.Ts)
        return ServoDelta(
            coefficients=np.where(slow[:, None, None], found, coefficients(self.nominal)),
            status=np.where(good & slow, Status.OK, Status.OUT_OF_RANGE).astype(np.int8),
            k_theta=np.where(slow, p["k_theta"], self.nominal["k_theta"]),
            rho=np.where(slow, p["rho"], self.nominal["rho"]),
        )

    def step(self, k: int, delta: ServoDelta, x: States, u: Inputs, w: Noises) -> Motion:
        """Advance one sample with constant voltage, then add the process noise."""
        from rmpc_bench.models.servo_compiled import compiled_servo, servo_step

        x_next, status = servo_step(compiled_servo(delta.coefficients, self.Ts), x, u, w)
        return Motion(x_next, np.where(delta.status != Status.OK, delta.status, status))

    def extra_signal(
        self, name: str, delta: ServoDelta, x: Float[Array, "runs samples 5"]
    ) -> Float[Array, "runs samples"]:
        """Return the torque of the shaft with the rigidity and the gear ratio of every run [N m]."""
        return shaft_torque(name, delta.k_theta, delta.rho, x)

    def between(
        self, delta: ServoDelta, x: StateSteps, u: InputSteps, parts: int, first: int = 0
    ) -> Float[Array, "runs steps parts nx"]:
        """Advance every period in equal parts, each as exactly as a whole period."""
        from rmpc_bench.models.servo_compiled import compiled_servo, servo_between

        return servo_between(compiled_servo(delta.coefficients, self.Ts / parts), x, u, parts)

    def compiled_form(self, delta: ServoDelta, n_steps: int) -> CompiledPlant:
        """Return the compiled step with the coefficients of every run."""
        from rmpc_bench.models.servo_compiled import compiled_servo

        return CompiledPlant(compiled_servo(delta.coefficients, self.Ts), (Term("x"),), delta.status)

    def linear(self, parameters: Mapping[str, float]) -> LinearPlant | None:
        """Sample the plant without dry friction."""
        return linear_part(with_current, parameters, self.Ts)

    def plots(self) -> tuple[Panel, ...]:
        """Draw the friction."""
        return friction_profiles(self.nominal)

    def warm_up(self) -> None:
        """Compile the kernel (or load it from the cache) by simulating one sample of one run."""
        one = {name: np.array([value]) for name, value in self.nominal.items()}
        delta = self.draw(one, [], 1)
        self.step(0, delta, np.zeros((1, 5)), np.zeros((1, 1)), np.zeros((1, 4)))


@dataclass(frozen=True, eq=False)
class ServoLinear(ServoPlant):
    """The linear servomechanism as a plant; create it with `design_linear`."""

    nx = 4

    def draw(self, parameters: ParameterValues, rngs: Generators, n_steps: int) -> LinearDelta:
        """Sample the dynamics of every run."""
        good = admissible(parameters)
        p = {name: np.where(good, values, self.nominal[name]) for name, values in parameters.items()}
        status = np.where(good, Status.OK, Status.OUT_OF_RANGE).astype(np.int8)
        return LinearDelta(*self._sampled(p, self.Ts), status, p)

    def step(self, k: int, delta: LinearDelta, x: States, u: Inputs, w: Noises) -> Motion:
        """Advance one sample with constant voltage, then add the process noise."""
        return Motion(mv(delta.E, x) + mv(delta.G, u) + w, delta.status)

    def extra_signal(
        self, name: str, delta: LinearDelta, x: Float[Array, "runs samples 4"]
    ) -> Float[Array, "runs samples"]:
        """Return the torque of the shaft with the rigidity and the gear ratio of every run [N m]."""
        return shaft_torque(name, delta.parameters["k_theta"], delta.parameters["rho"], x)

    def between(
        self, delta: LinearDelta, x: StateSteps, u: InputSteps, parts: int, first: int = 0
    ) -> Float[Array, "runs steps parts nx"]:
        """Advance every period in equal parts by the matrix exponentials of this shorter time."""
        return linear_between(*self._sampled(delta.parameters, self.Ts / parts), x, u, parts)

    def _sampled(self, p: Mapping[str, Float[Array, " runs"]], Ts: float) -> tuple[Array, Array]:
        # Extreme parameters may overflow; such a run diverges.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            E, G = discretise(*continuous(p), Ts)
        # `mv` would copy them at every sample.
        return np.ascontiguousarray(E), np.ascontiguousarray(G)

    def compiled_form(self, delta: LinearDelta, n_steps: int) -> CompiledPlant:
        """Return the sampled dynamics of every run."""
        step = Term("x", (delta.E[:, None],)), Term("u", (delta.G[:, None],)), Term("w")
        return CompiledPlant(step, (Term("x"),), delta.status)

    def linear(self, parameters: Mapping[str, float]) -> LinearPlant | None:
        """Sample the plant."""
        return linear_part(continuous, parameters, self.Ts)


@takes(NONLINEAR)
def design(Ts: float, **parameters: float) -> Servo:
    """Nonlinear servomechanism; `perturb` and `set` accept all keys.

    Parameters
    ----------
    Ts : sampling time [s]
    parameters : those of the servomechanism

    Raises
    ------
    DesignError
        If a mode of the linear part is too fast for the kernel: the inductance or an inertia is too small.
    """
    return Servo(Ts, nonlinear_parameters(parameters, Ts))


@takes(LINEAR)
def design_linear(Ts: float, **parameters: float) -> ServoLinear:
    """Linear servomechanism as a plant: no inductance, no dry friction.

    Parameters
    ----------
    Ts : sampling time [s]
    parameters : those of the linear servomechanism
    """
    return ServoLinear(Ts, values_of(LINEAR, parameters))
