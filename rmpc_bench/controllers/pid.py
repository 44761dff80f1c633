"""PID control in parallel form, one loop per input, with a filtered derivative and anti-windup.

Model   u = u_op + P + I + D with three independent gains:
            P = Kp (b r - y),   I = Ki integral of (r - y),   D = Kd s / (1 + Tf s) (c r - y).
        The ISA standard form has Ki = Kp / Ti and Kd = Kp Td.  At an operating point r and y are deviations from y_op.
        Discretised by backward Euler with the sampling time Ts, for the integral and for the derivative:
            I(k) = I(k-1) + Ki Ts (r(k) - y(k)),
            D(k) = (Tf D(k-1) + Kd (e_D(k) - e_D(k-1))) / (Tf + Ts),   e_D = c r - y,
        with D(0) = 0.  The input is clipped to `limits`, and then to the bounds of the plant; the result is u(k).
        Where u(k) differs from the sum v(k) of the parts, `anti_windup` selects I(k):
            back-calculation  I(k) is corrected by (Ts / Tt) (u(k) - v(k)),
            clamping          I(k) = I(k-1) where Ki (r(k) - y(k)) drives v(k) further beyond the limit,
            none              I(k) has no correction.
        A missing measurement (NaN) of a loop is replaced by its last one, or y_op before the first one.
Source  Astrom and Hagglund, PID Controllers: Theory, Design, and Tuning (1995), with their rule for `Tt` as default.
Limit   Ki = Kd = 0 is the proportional law u = u_op + Kp (b r - y).
Cost    About fifteen operations per run, step and loop.
Fails   Design error: the numbers of inputs and outputs differ and `outputs` does not choose them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.limits import AntiWindup, Bounds, InputLimits, bounds_of, common_limits
from rmpc_bench.numerics.linalg import as_vector, mv
from rmpc_bench.types import (
    Array,
    Command,
    Controller,
    DesignError,
    Estimate,
    LawState,
    LinearLaw,
    Model,
    NonNegative,
    OperatingPoint,
    Positive,
    as_command,
)
from rmpc_bench.types.angles import wrapped
from rmpc_bench.types.errors import unknown

EQUATION = r"u = u_{op} + K_p (b r - y) + \frac{K_i}{s} (r - y) + \frac{K_d s}{1 + T_f s} (c r - y)"
Gains: TypeAlias = Float[Array, " nu"]


class PidState(NamedTuple):
    """State of the loops after a sample."""

    integral: Float[Array, "runs nu"]
    """Without the anti-windup of the last sample, which needs the input that has acted."""
    derivative: Float[Array, "runs nu"]
    error: Float[Array, "runs nu"]
    """c r - y of the derivative at the last sample; NaN before the first one."""
    y: Float[Array, "runs nu"]
    """Last measurement."""
    step: Float[Array, "runs nu"]
    """What the last sample has added to the integral."""
    v: Float[Array, "runs nu"]
    """Last sum of the parts."""
    u: Float[Array, "runs nu"]
    """Last input."""


@dataclass(frozen=True, eq=False)
class Pid(Controller):
    """PID loops; create them with `design`.  Every gain has one entry per input."""

    Ts: float
    nx: int
    """Number of states of the model."""
    Kp: Gains
    Ki: Gains
    Kd: Gains
    Tf: Gains
    b: Gains
    c: Gains
    rows: Float[Array, "nu ny"]
    """Selects the output of every loop."""
    bounds: Bounds
    anti_windup: AntiWindup
    correction: Gains
    """Ts / Tt."""
    bumpless: bool
    C: Float[Array, "ny nx"] | None
    """Output matrix of the model where the loops use the output of the estimate, None where they use y."""
    d0: Float[Array, " ny"] | None
    point: OperatingPoint | None
    model: Model | None = None
    """Nonlinear design model whose output of the estimate the loops use."""
    period: Gains | None = None
    """Period of the output of every loop, 0 of one that is no angle."""
    F: Float[Array, "nu nd"] | None = None
    """Gains of measured disturbances; None without."""

    @property
    def input_limits(self) -> tuple[float, float] | Bounds | None:
        """Lower and upper limit of the inputs; None without limits."""
        return common_limits(self.bounds)

    @property
    def uses_estimate(self) -> bool:
        """Whether the loops use the output of the estimate."""
        return self.C is not None

    @property
    def u_op(self) -> Gains:
        """Input without any control error."""
        return np.zeros(len(self.Kp)) if self.point is None else self.point.u

    @property
    def y_op(self) -> Gains:
        """Output of every loop at the operating point."""
        return np.zeros(len(self.Kp)) if self.point is None else self.rows @ self.point.y

    def init(self, n_runs: int) -> PidState:
        """Start with an integral of 0 and without a previous error."""
        zero = np.zeros((n_runs, len(self.Kp)))
        return PidState(zero, zero, np.full_like(zero, np.nan), np.tile(self.y_op, (n_runs, 1)), zero, zero, zero)

    def control(
        self, k: int, state: PidState, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[PidState, Command]:
        """Add up the three parts and clip."""
        measured = self._controlled(k, y, estimate)
        measured = self._turned(np.where(np.isnan(measured), state.y, measured), state.y)
        target, deviation = self._turned(self.rows @ r[0], measured) - self.y_op, measured - self.y_op
        first = np.isnan(state.error)
        proportional = self.Kp * (self.b * target - deviation)
        error = self.c * target - deviation
        change = wrapped(np.where(first, 0.0, error - state.error), self.period)
        derivative = (self.Tf * state.derivative + self.Kd * change) / (self.Tf + self.Ts)
        step = self.Ki * self.Ts * (target - deviation)
        integral = self.integral(state) + step
        if self.bumpless:
            # u(0) = u_op: the integral starts with what cancels the other part.
            integral = np.where(first, -proportional, integral)
        v = self.u_op + proportional + integral + derivative
        if self.F is not None:
            v = v + mv(self.F, estimate.info["measured"])
        # A run without an estimate ends, although these loops may not need it.
        u = np.where(np.isnan(estimate.x_hat).any(axis=1, keepdims=True), np.nan, np.clip(v, *self.bounds))
        return PidState(integral, derivative, error, measured, step, v, u), as_command(Command(u))

    def applied(self, k: int, state: PidState, u: Float[Array, "runs nu"]) -> PidState:
        """Keep the input that acts, for the anti-windup."""
        return state._replace(u=u)

    def with_period(self, period: Float[Array, " ny"]) -> Pid:
        """Return the loops with outputs of which some are angles."""
        return replace(self, period=self.rows @ period)

    def _turned(self, value: Array, centre: Float[Array, "runs nu"]) -> Array:
        """Return an output, or its reference, within half a period of the last output."""
        return value if self.period is None else centre + wrapped(value - centre, self.period)

    def _controlled(self, k: int, y: Float[Array, "runs ny"], estimate: Estimate) -> Float[Array, "runs nu"]:
        """Return the controlled output of every loop."""
        outputs = y if self.C is None else mv(self.C, estimate.x_hat) + self.d0
        outputs = outputs if self.model is None else self.model.measured(k, estimate.x_hat)
        # Chosen, not multiplied by `rows`: 0 times a missing measurement of another loop is NaN.
        return outputs[:, self.rows.argmax(axis=1)]

    def integral(self, state: PidState) -> Float[Array, "runs nu"]:
        """Return the integral after the last sample, with anti-windup where limits have changed its input."""
        cut = state.u - state.v
        if self.anti_windup == "back-calculation":
            return state.integral + np.where(self.Ki != 0.0, self.correction * cut, 0.0)
        if self.anti_windup == "clamping":
            return state.integral - np.where(state.step * cut < 0.0, state.step, 0.0)
        return state.integral

    def linear_law(self) -> LinearLaw | None:
        """Return the gains without limits; None where the output of the estimate is not linear."""
        if self.model is not None:
            return None
        affine = self.point is not None or bool(self.d0 is not None and self.d0.any())
        nu = len(self.Kp)
        K_s, K, A_s, B = _as_state(self)
        nothing = np.zeros((nu, 0))
        if self.C is None:
            unused, nx = np.zeros((len(A_s), self.nx)), self.nx
            state = LawState(K_s, K @ self.rows, A_s, unused, B @ self.rows)
            return LinearLaw(np.zeros((nu, nx)), np.eye(nu), nothing, state, affine)
        rows = self.rows @ self.C
        unused_y = np.zeros((len(A_s), self.rows.shape[1]))
        state = LawState(K_s, np.zeros(self.rows.shape), A_s, B @ rows, unused_y)
        return LinearLaw(-K @ rows, np.eye(nu), nothing, state, affine)


def _as_state(pid: Pid) -> tuple[Array, Array, Array, Array]:
    """Return K_s, K, A_s and B of s(k+1) = A_s s + B y and u = K_s s + K y for r = 0, y that of the loops."""
    # The state has the integrals with Ki != 0, then the derivatives with Kd != 0, then their previous errors -y: a
    # state without effect would add a pole that the loop does not have.
    eye = np.eye(len(pid.Kp))
    summed, derived = eye[pid.Ki != 0.0], eye[pid.Kd != 0.0]
    decay, gain = derived @ (pid.Tf / (pid.Tf + pid.Ts)), derived @ (pid.Kd / (pid.Tf + pid.Ts))
    n, m = len(summed), len(derived)
    A_s = np.zeros((n + 2 * m, n + 2 * m))
    A_s[:n, :n], A_s[n : n + m, n : n + m], A_s[n : n + m, n + m :] = np.eye(n), np.diag(decay), -np.diag(gain)
    B = np.vstack([-summed * (pid.Ki * pid.Ts), -gain[:, None] * derived, -derived])
    # u(k) uses the integral and the derivative at k, which are the state at k+1.
    out = np.hstack([summed.T, derived.T, 0.0 * derived.T])
    return out @ A_s, out @ B - np.diag(pid.Kp), A_s, B


def design(
    model: Model,
    Ts: float,
    measured: Sequence[str] = (),
    *,
    Kp: float | list[float],
    Ki: float | list[float] = 0.0,
    Kd: float | list[float] = 0.0,
    Tf: NonNegative | list[NonNegative] = 0.0,
    b: float | list[float] = 1.0,
    c: float | list[float] = 0.0,
    on: Literal["y", "estimate"] = "y",
    outputs: list[int] | None = None,
    limits: InputLimits | None = None,
    anti_windup: AntiWindup = "back-calculation",
    Tt: Positive | list[Positive] | None = None,
    start: Literal["rest", "bumpless"] = "rest",
    feedforward: dict[str, float | list[float]] | None = None,
) -> Pid:
    """PID control in parallel form, one loop per input.

    Parameters
    ----------
    model : design model, for the numbers of inputs and outputs and the operating point
    Ts : sampling time [s]
    measured : names of the measured disturbances
    Kp : proportional gain [input unit / output unit]
    Ki : integral gain [input unit / (output unit s)]
    Kd : derivative gain [input unit s / output unit]
    Tf : time constant of the filter of the derivative [s], 0 for none
    b : weight of the reference in the proportional part
    c : weight of the reference in the derivative
    on : `y` controls the measured output, `estimate` the output C x_hat + d0 of the estimate, h(x_hat) of a
        nonlinear model
    outputs : output of the loop of every input, counted from 0 (default: input i controls output i)
    limits : bounds of the input, `{u: [low, high]}` or one pair per input
    anti_windup : treatment of the integral while a limit acts
    Tt : tracking time of the back-calculation [s], at least Ts (default: sqrt(Kd / Ki), without a derivative Kp / Ki)
    feedforward : measured disturbance (`only` of the section `input`) -> gain on its deviation from the operating point
    start : `rest` starts with an integral of 0, `bumpless` with the one that gives u(0) = u_op

    Raises
    ------
    DesignError
        If the loops, the sizes of the gains or the limits do not fit.
    """
    nu, ny = model.nu, model.ny
    rows = np.eye(ny)[_loops(outputs, nu, ny)]
    F = np.zeros((nu, len(measured)))
    for name, gain in (feedforward or {}).items():
        if name not in measured:
            raise DesignError(unknown(name, measured, "measured disturbance of `input`, `only`"), "feedforward")
        F[:, measured.index(name)] = as_vector(gain, nu, f"feedforward.{name}")
    gains = {"Kp": Kp, "Ki": Ki, "Kd": Kd, "Tf": Tf, "b": b, "c": c}
    sized = {name: as_vector(value, nu, name) for name, value in gains.items()}
    if Tt is not None and anti_windup != "back-calculation":
        raise DesignError("has no effect without `anti_windup: back-calculation`", "Tt")
    if start == "bumpless" and not (sized["Ki"] != 0.0).all():
        raise DesignError("`bumpless` needs an integral in every loop; choose Ki other than 0", "start")
    tracking = _tracking_time(sized, Ts) if Tt is None else as_vector(Tt, nu, "Tt")
    if (tracking < Ts).any():
        raise DesignError(f"must be at least the sampling time {Ts:g} (got {tracking.min():g})", "Tt")
    if on == "estimate":
        model.refuse_feedthrough("`on: estimate`")
    constant = _linear(model) if on == "estimate" else None
    C, d0 = (None, None) if constant is None else (constant.C, constant.d0)
    return Pid(
        Ts,
        model.nx,
        **sized,
        rows=rows,
        bounds=bounds_of(None if limits is None else limits.u, nu, "limits.u"),
        anti_windup=anti_windup,
        correction=Ts / tracking,
        bumpless=start == "bumpless",
        C=C,
        d0=d0,
        point=model.operating_point,
        model=model if on == "estimate" and constant is None else None,
        F=F if feedforward else None,
    )


def _linear(model: Model) -> Any:
    """Return the linear model of the output; None for a nonlinear one without an operating point."""
    try:
        return model.at(0)
    except DesignError:
        if model.flow is None:
            raise
    return None


def _loops(outputs: list[int] | None, nu: int, ny: int) -> list[int]:
    """Return the output of the loop of every input."""
    if outputs is None:
        if nu != ny:
            message = f"needs as many outputs as inputs (the model has {ny} and {nu}); choose them by `outputs`"
            raise DesignError(message, "kind")
        return list(range(nu))
    if len(outputs) != nu or not all(0 <= each < ny for each in outputs):
        raise DesignError(f"must have {nu} numbers from 0 to {ny - 1}, one per input (got {outputs})", "outputs")
    return outputs


def _tracking_time(gains: dict[str, Gains], Ts: float) -> Gains:
    """Return sqrt(Ti Td) = sqrt(Kd / Ki) of loops with a derivative, Ti = Kp / Ki of others, but at least Ts."""
    Kp, Ki, Kd = (np.abs(gains[name]) for name in ("Kp", "Ki", "Kd"))
    divisor = np.where(Ki > 0.0, Ki, 1.0)
    found = np.where(Kd > 0.0, np.sqrt(Kd / divisor), Kp / divisor)
    return np.maximum(np.where(Ki > 0.0, found, Ts), Ts)
