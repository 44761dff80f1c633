"""The laws of model predictive control: linear with clipped inputs, and with its limits as constraints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.constrained import ConstrainedMoves, with_fallback
from rmpc_bench.controllers.limits import Bounds, Fallback, without_effect
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.types import Array, Command, CompiledLaw, Controller, Estimate, LinearLaw, OptimisedStep, as_command


class MpcState(NamedTuple):
    """State of the controller between steps."""

    u_previous: Float[Array, "runs nu"]


@dataclass(frozen=True, eq=False)
class Mpc(Controller):
    """The receding-horizon law; create it with `design`."""

    K_x: Float[Array, "nu nx"]
    K_u: Float[Array, "nu nu"]
    K_r: Float[Array, "nu rows"]
    low: float | Float[Array, " nu"]
    """A number where it is the same for all inputs."""
    high: float | Float[Array, " nu"]
    preview: int
    K_d: Float[Array, "nu nx"] | None = None
    """Gain of the estimated mean of the process noise, None if the estimator does not estimate it."""
    u_0: Float[Array, " nu"] | None = None
    """Input that compensates the constant parts of the model, None if they are zero."""
    u_op: Float[Array, " nu"] | None = None
    """Input before k = 0; None for 0."""
    du: Bounds | None = None
    """Bounds of the increment; None without."""

    compares_estimate = True

    @property
    def input_limits(self) -> tuple[float | Float[Array, " nu"], float | Float[Array, " nu"]]:
        """Lower and upper limit of all inputs, or of each."""
        return self.low, self.high

    @property
    def has_compiled_form(self) -> bool:
        """A law that uses an estimated mean, limits the increment or has different limits of its inputs has none."""
        return self.K_d is None and self.du is None and isinstance(self.low, float)

    def compiled_form(self, r: Float[Array, "known ny"], n_steps: int, runs: Sequence[int]) -> CompiledLaw:
        """Return the gains and what the reference adds at every k."""
        ahead = np.array([r[k + 1 : k + self.preview].ravel() for k in range(n_steps)])
        given = mv(self.K_r, ahead)[None]
        u_0 = None if self.u_0 is None else self.u_0[None]
        low, high = float(self.low), float(self.high)
        return CompiledLaw(given, self.K_x[None], self.K_u, u_0, low, high, self.u_op)

    def init(self, n_runs: int) -> MpcState:
        """Start from the input of the operating point, or 0."""
        nu = len(self.K_x)
        return MpcState(np.tile(np.zeros(nu) if self.u_op is None else self.u_op, (n_runs, 1)))

    def control(
        self, k: int, state: MpcState, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[MpcState, Command]:
        """Apply the first input of the minimiser, clipped."""
        u = self._clipped(self._minimiser(state.u_previous, estimate, r), state.u_previous)
        return MpcState(u), as_command(Command(u))

    def applied(self, k: int, state: MpcState, u: Float[Array, "runs nu"]) -> MpcState:
        """Keep the input that acts: u(k-1) of the next sample."""
        return MpcState(u)

    def _minimiser(
        self, u_previous: Float[Array, "runs nu"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> Float[Array, "runs nu"]:
        """Return the first input of the minimiser without limits."""
        # The reference is the same for all runs.
        ahead = mv(self.K_r, r[1:].reshape(1, -1))
        # Exactly 0 if K_u = I.
        kept = u_previous - mv(self.K_u, u_previous)
        u = kept + ahead - mv(self.K_x, estimate.x_hat)
        if self.u_0 is not None:
            u = u - self.u_0
        if self.K_d is not None:
            u = u - mv(self.K_d, estimate.info["w_mean"])
        return u

    def _clipped(self, u: Float[Array, "runs nu"], u_previous: Float[Array, "runs nu"]) -> Float[Array, "runs nu"]:
        """Clip the increment, then the input."""
        if self.du is not None:
            # An increment within its bounds keeps the bits of u.
            u = np.clip(u, u_previous + self.du.low, u_previous + self.du.high)
        return np.clip(u, self.low, self.high)

    def linear_law(self) -> LinearLaw | None:
        """Return the gains as long as no input is clipped; None if the law uses an estimated mean."""
        affine = self.u_0 is not None or self.u_op is not None
        return None if self.K_d is not None else LinearLaw(self.K_x, self.K_u, self.K_r, affine=affine)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Say which inputs the cost cannot use."""
        return without_effect(self.K_r, self.preview - 1, "Hp")


@dataclass(frozen=True, eq=False)
class VaryingMpc(Mpc):
    """The law of a model that varies with k, with a law of its own for every k; create it with `design`."""

    laws: Sequence[Mpc] = field(kw_only=True)

    @property
    def has_compiled_form(self) -> bool:
        """Compiled loops have one K_r."""
        return False

    def control(
        self, k: int, state: MpcState, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[MpcState, Command]:
        """Apply the law of k."""
        return self.laws[k].control(k, state, y, estimate, r)

    def linear_law(self) -> LinearLaw | None:
        """Its gains are not constant."""
        return None


@dataclass(frozen=True, eq=False)
class ConstrainedMpc(Mpc):
    """The law whose limits are constraints of the optimisation; create it with `design`."""

    program: ConstrainedMoves = field(kw_only=True)
    fallback: Fallback | None = field(kw_only=True)

    @property
    def has_compiled_form(self) -> bool:
        """It is not linear."""
        return False

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """How the moves were found: values of `OptimisedStep`."""
        return {"qp": ()}

    @property
    def cost_per_step(self) -> float:
        """Time of a step for which a share of the programs is solved [s]."""
        return 2e-6

    def control(
        self, k: int, state: MpcState, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[MpcState, Command]:
        """Apply the first input of the constrained minimiser."""
        before, nu = state.u_previous, len(self.K_x)
        mean = () if self.K_d is None else (estimate.info["w_mean"],)
        found = self.program.moves(np.hstack([estimate.x_hat, before, *mean]), np.append(r[1:].ravel(), 1.0))
        clipped = self._clipped(self._minimiser(before, estimate, r), before)
        u, solved = clipped, found.steps != OptimisedStep.SKIPPED
        if solved.any():
            # The input of a skipped run has the bits of `enforce: clip`.
            u = np.where(solved[:, None], self._clipped(before + found.V[:, :nu], before), clipped)
        command = with_fallback(u, clipped, before, found.steps, self.fallback)
        return MpcState(command.u), command
