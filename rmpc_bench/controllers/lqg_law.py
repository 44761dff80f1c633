"""The law of linear-quadratic control with integrals of the control error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.limits import AntiWindup, Bounds, common_limits
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.types import (
    Ahead,
    Array,
    Command,
    Controller,
    Estimate,
    LawState,
    LinearLaw,
    OperatingPoint,
    as_command,
)


class LqgState(NamedTuple):
    """State of the controller between steps."""

    q: Float[Array, "runs nq"]  # sums of the control errors before the last sample, without columns where Q_i is 0
    error: Float[Array, "runs nq"]  # error of the last sample, which is summed once the input that has acted is known
    v: Float[Array, "runs nu"]  # last input of the law before limits
    u: Float[Array, "runs nu"]  # last input


@dataclass(frozen=True, eq=False)
class Lqg(Controller):
    """u = u_op + u_0 + K_r (r - y_op) - K_x (x_hat - x_op) - K_d w_mean - K_q q; create it with `design`."""

    K_x: Float[Array, "nu nx"]
    K_q: Float[Array, "nu nq"]
    K_r: Float[Array, "nu nz"]
    """Of the tracked outputs."""
    u_0: Float[Array, " nu"]
    """Input that compensates the constant parts of the model."""
    K_d: Float[Array, "nu nx"] | None
    """Gain of the estimated mean of the process noise, None if the estimator does not estimate it."""
    rows: Float[Array, "nz ny"]
    """Selects the tracked outputs."""
    bounds: Bounds
    anti_windup: AntiWindup
    correction: Float[Array, "nq nu"]
    """(Ts / Tt) K_q^+."""
    C: Float[Array, "ny nx"] | None
    """Output matrix where the errors of the estimate are summed, None where those of y are."""
    d0: Float[Array, " ny"] | None
    point: OperatingPoint | None

    compares_estimate = True

    @property
    def input_limits(self) -> tuple[float, float] | Bounds | None:
        """Lower and upper limit of the inputs; None without limits."""
        return common_limits(self.bounds)

    def init(self, n_runs: int) -> LqgState:
        """Start with sums of 0."""
        nu, nq = self.K_q.shape
        q, u = np.zeros((n_runs, nq)), np.zeros((n_runs, nu))
        return LqgState(q, q, u, u)

    def control(
        self, k: int, state: LqgState, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[LqgState, Command]:
        """Apply the law, clip, and sum the error."""
        x_hat, target, u_0 = estimate.x_hat, r[0], self.u_0
        if self.point is not None:
            x_hat, target, u_0 = x_hat - self.point.x, target - self.point.y, u_0 + self.point.u
        v = u_0 + mv(self.K_r, (self.rows @ target)[None]) - mv(self.K_x, x_hat)
        if self.K_d is not None:
            v = v - mv(self.K_d, estimate.info["w_mean"])
        if self.K_q.shape[1] == 0:
            return state, as_command(Command(np.clip(v, *self.bounds)))
        q = self.sums(state)
        v = v - mv(self.K_q, q)
        u = np.clip(v, *self.bounds)
        outputs = y if self.C is None else mv(self.C, estimate.x_hat) + self.d0
        return LqgState(q, self._errors(outputs, r[0]), v, u), as_command(Command(u))

    def control_ahead(
        self, k: int, state: LqgState, y: Array, estimate: Estimate, r: Array, ahead: Ahead
    ) -> tuple[LqgState, Command]:
        """Apply the law with the predicted errors in its sums, which keep the errors up to k only."""
        if self.K_q.shape[1] == 0:
            return super().control_ahead(k, state, y, estimate, r, ahead)
        q, y_hat = self.sums(state), ahead.y_hat
        expected = q + sum(self._errors(*pair) for pair in zip(y_hat, r, strict=False))
        there = LqgState(expected, 0.0 * q, state.u, state.u)
        after, command = self.control(ahead.acts, there, y, estimate, r[len(y_hat) :])
        return after._replace(q=q, error=self._errors(y if self.C is None else y_hat[0], r[0])), command

    def _errors(self, outputs: Float[Array, "runs ny"], r: Float[Array, " ny"]) -> Float[Array, "runs nq"]:
        """Return the errors of the tracked outputs; 0 where a measurement is missing."""
        # Chosen, not multiplied by `rows`: 0 times a missing measurement of another output is NaN.
        error = (outputs - r)[:, self.rows.argmax(axis=1)]
        return np.where(np.isnan(error), 0.0, error)

    def applied(self, k: int, state: LqgState, u: Float[Array, "runs nu"]) -> LqgState:
        """Keep the input that acts, for the anti-windup."""
        return state._replace(u=u)

    def sums(self, state: LqgState) -> Float[Array, "runs nq"]:
        """Return the sums with the last sample, with anti-windup where limits have changed its input."""
        error, excess = state.error, state.v - state.u
        if self.anti_windup == "back-calculation":
            error = error + mv(self.correction, excess)
        if self.anti_windup == "clamping":
            driven = -self.K_q * error[:, None, :] * excess[:, :, None]
            error = np.where((driven > 0.0).any(axis=1), 0.0, error)
        return state.q + error

    def linear_law(self) -> LinearLaw | None:
        """Return the gains without limits; None if the law uses an estimated mean."""
        if self.K_d is not None:
            return None
        affine = self.point is not None or bool(self.u_0.any() or (self.d0 is not None and self.d0.any()))
        (nu, nx), nq = self.K_x.shape, self.K_q.shape[1]
        law = LinearLaw(self.K_x, np.eye(nu), np.zeros((nu, 0)), affine=affine)
        if nq == 0:
            return law
        of_y = self.rows if self.C is None else np.zeros(self.rows.shape)
        of_x = np.zeros((nq, nx)) if self.C is None else self.rows @ self.C
        return law._replace(state=LawState(-self.K_q, np.zeros((nu, of_y.shape[1])), np.eye(nq), of_x, of_y))
