"""Laws of generalised predictive control, whose cost, assumptions and keys gpc.py defines.

Contents
    1  law with a constant output weight                       Gpc
    2  law with an output weight adapted to the noise          TunedGpc

Limits  Without limits, with limits that clip, and where no limit acts the inputs have the same bits; gpc_limits.py has
        the programs.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.gpc_limits import GpcLimits
from rmpc_bench.controllers.limits import Bounds, one_for_all, without_effect
from rmpc_bench.controllers.noise_tuning import NoiseTuning, TuningData
from rmpc_bench.controllers.prediction import Frozen, frozen, with_mean, with_output
from rmpc_bench.models.state_dependent import StateDependentModel
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.numerics.tracking import RunProblems, TrackingLaw
from rmpc_bench.types import Ahead, Array, Command, Controller, Estimate, LinearLaw, as_command


class GpcState(NamedTuple):
    """State of the controller between steps."""

    x_previous: Float[Array, "runs nx"]
    u_previous: Float[Array, "runs nu"]


class TunedState(NamedTuple):
    """State of the controller with an adapted output weight between steps."""

    x_previous: Float[Array, "runs nx"]
    u_previous: Float[Array, "runs nu"]
    """Previous input; its deviation from u_op if the model has an operating point."""
    Q_yw: Float[Array, "runs ny ny"]
    window: Float[Array, "runs samples numbers"]
    w_mean_previous: Float[Array, "runs nx"]
    """Estimated mean of the process noise, 0 if the estimator does not estimate it."""


@dataclass(frozen=True, eq=False)
class Gpc(Controller):
    """The law with a constant output weight; create it with `design`."""

    model: Any  # design model, linear or state-dependent
    Np: int  # prediction horizon [samples]
    Q_yw: Float[Array, "ny ny"]  # root of the output weight
    R_u: Float[Array, "nu nu"]  # upper triangular root of the input weight
    gains: TrackingLaw | None  # the constant law, None if the law varies with k or with the state
    uses_mean: bool  # whether the predictions use the estimated mean of the process noise
    limits: GpcLimits | None = field(default=None, kw_only=True)  # limits of inputs and signals; None without

    compares_estimate = True

    @property
    def preview(self) -> int:
        """Samples r(k)..r(k+Np)."""
        return self.Np + 1

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """What the info of a command has."""
        optimised = self.limits is not None and self.limits.optimised
        return {"Q_yw": self.Q_yw.shape, "loss": (), **({"qp": ()} if optimised else {})}

    @property
    def cost_per_step(self) -> float:
        """Time of the recursion, of a linearisation run by run, and of programs in a quarter of the samples [s]."""
        optimised = self.limits is not None and self.limits.optimised
        if self.gains is not None:
            return 2e-5 if optimised else 0.0
        return 1.2e-6 * self.Np + (3e-4 if self._offsets else 0.0) + (1e-4 if optimised else 0.0)

    @property
    def input_limits(self) -> tuple[float | Float[Array, " nu"], float | Float[Array, " nu"]] | None:
        """Lower and upper limit of all inputs, or of each."""
        if self.limits is None:
            return None
        low, high = self.limits.u
        return one_for_all(Bounds(low + self.model.u_op, high + self.model.u_op))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Say which inputs a constant law cannot use."""
        return () if self.gains is None else without_effect(self.gains.K_w, self.Np, "Np")

    def linear_law(self) -> LinearLaw | None:
        """Return the gains of a constant law without limits; None if it uses an estimated mean."""
        if self.gains is None or self.uses_mean:
            return None
        affine = bool(self.gains.u_0.any() or self.model.operating_point is not None or self.model.d0.any())
        return LinearLaw(self.gains.K_x, np.eye(len(self.R_u)), self.gains.K_w, affine=affine)

    def init(self, n_runs: int) -> GpcState | TunedState:
        """Start with a previous estimate of 0, which the law does not use at k = 0."""
        return GpcState(np.zeros((n_runs, self._nx)), np.zeros((n_runs, len(self.R_u))))

    def control(
        self, k: int, state: Any, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[Any, Command]:
        """Apply the first input of the minimiser."""
        x_hat = estimate.x_hat
        if self.gains is not None:
            x, w = self._extended(estimate), r[1:] - self._frozen(k, x_hat, state.u_previous).d
            u, loss = _linear(self.gains, x, w)
            command = Command(u) if self.limits is None else self.limits.constant(u, x, state.u_previous, w)
        else:
            now = self._frozen(k, state.x_previous if k else x_hat, state.u_previous)
            command, loss = self._first(k, now, self.Q_yw[None], estimate, r, state.u_previous)
        info = {"Q_yw": np.broadcast_to(self.Q_yw, (len(x_hat), *self.Q_yw.shape)), "loss": loss}
        return GpcState(x_hat, command.u), self._physical(command, info)

    def control_ahead(
        self, k: int, state: Any, y: Array, estimate: Estimate, r: Array, ahead: Ahead
    ) -> tuple[Any, Command]:
        """Apply the law at k + d; the first call has no earlier estimate to linearise at."""
        state = state if k else state._replace(x_previous=estimate.x_hat)
        return super().control_ahead(k, state, y, estimate, r, ahead)

    def applied(self, k: int, state: Any, u: Float[Array, "runs nu"]) -> Any:
        """Keep the input that acts; one that nothing has changed keeps its bits."""
        if self.model.operating_point is not None:
            same = u == state.u_previous + self.model.u_op
            u = np.where(same, state.u_previous, u - self.model.u_op)
        return state._replace(u_previous=u)

    def warm_up(self) -> None:
        """Compile the kernels of a step before the design is sent to workers."""
        if self.gains is None:
            self._try(0)

    def _try(self, k: int) -> None:
        ny = len(self.Q_yw)
        x_hat = np.zeros((1, self._nx))
        nothing = Estimate(x_hat, info={"w_mean": x_hat})
        self.control(k, self.init(1), np.zeros((1, ny)), nothing, np.zeros((self.preview, ny)))

    @cached_property
    def _follows(self) -> bool:
        """Whether the model is state-dependent."""
        return isinstance(self.model, StateDependentModel)

    @cached_property
    def _offsets(self) -> bool:
        """Whether the model has constant parts and an output matrix of every run."""
        return bool(self._follows and self.model.has_offsets)

    @cached_property
    def _nx(self) -> int:
        return int(self.model.nx if self._follows else self.model.at(0).nx)

    def _frozen(self, k: int, x: Float[Array, "runs nx"], u: Float[Array, "runs nu"]) -> Frozen:
        """Return the model at k; a state-dependent model is evaluated at x, and at u if it depends on the input."""
        if self._offsets:
            return with_output(self.model.around(k, x, u))
        if self._follows:
            (A, B), C = self.model.at_state(x), self.model.C
            return Frozen(A, B, np.zeros(C.shape[1]), C, np.zeros(len(C)))
        return frozen(self.model.at(k))

    def _physical(self, command: Command, info: dict[str, Array]) -> Command:
        """Return a command whose inputs are deviations from the operating point as one of the inputs themselves."""
        u = command.u if self.model.operating_point is None else command.u + self.model.u_op
        return as_command(command._replace(u=u, info={**info, **command.info}))

    def _first(
        self,
        k: int,
        now: Frozen,
        Q_yw: Float[Array, "weights ny ny"],
        estimate: Estimate,
        r: Float[Array, "preview ny"],
        u_previous: Float[Array, "runs nu"],
    ) -> tuple[Command, Float[Array, " runs"]]:
        """Return the command, with deviations from the operating point, and the minimal costs without limits."""
        now = with_mean(now) if self.uses_mean else now
        A, B = (matrix if matrix.ndim == 3 else matrix[None] for matrix in (now.A, now.B))
        x, w = self._extended(estimate), r[1:] - now.d
        if self.limits is not None and self.limits.horizon is not None:
            rows, now = self.limits.horizon.at(k), now._replace(A=A, B=B)
            return self.limits.varying(now, (Q_yw, self.R_u), rows, x, u_previous, w)
        u, loss = RunProblems(A, B, now.f, now.C, Q_yw, self.R_u, w, x).first_inputs()
        return Command(u if self.limits is None else self.limits.clipped(u, u_previous)), loss

    def _extended(self, estimate: Estimate) -> Float[Array, "runs n"]:
        """Return the estimate, followed by the estimated mean of the process noise if it is used."""
        if self._offsets:
            # The states of `with_output`: its output at k has no effect.
            nothing = np.zeros((len(estimate.x_hat), len(self.Q_yw)))
            return np.hstack([estimate.x_hat, nothing, np.ones((len(nothing), 1))])
        return np.hstack([estimate.x_hat, estimate.info["w_mean"]]) if self.uses_mean else estimate.x_hat


@dataclass(frozen=True, eq=False)
class TunedGpc(Gpc):
    """The law with an output weight adapted to the noise; create it with `design`."""

    noise: NoiseTuning  # tuning of the output weight

    allows_delay = False
    allows_late_outputs = False

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """What the info of a command has."""
        return {**super().reports, **self.noise.reports}

    @property
    def cost_per_step(self) -> float:
        """Time of the recursion and of LP2 [s]."""
        return super().cost_per_step + (25e-6 if self.noise.keys.state_rows else 7e-6)

    def init(self, n_runs: int) -> TunedState:
        """Start with the output weight of the design and an empty window."""
        Q_yw, nu = np.tile(self.Q_yw, (n_runs, 1, 1)), len(self.R_u)
        nothing = np.zeros((n_runs, self._nx))
        return TunedState(nothing, np.zeros((n_runs, nu)), Q_yw, self.noise.init(n_runs), nothing)

    def control(
        self, k: int, state: Any, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[Any, Command]:
        """Compute the output weight and apply the first input of the minimiser."""
        x_hat = estimate.x_hat
        now = self._frozen(k, state.x_previous if k else x_hat, state.u_previous)
        before = now if self._follows or k == 0 else self._frozen(k - 1, x_hat, state.u_previous)
        x_tilde = mv(before.A, state.x_previous) + mv(before.B, state.u_previous) + before.f
        x_tilde = x_tilde + state.w_mean_previous if self.uses_mean else x_tilde
        sample = TuningData(y, mv(now.C, x_hat) + now.d, x_hat, x_tilde if k else np.full_like(x_hat, np.nan))
        point = self.model.operating_point
        if point is not None:
            # The fits have no constant term: they are those of the deviations.
            signals = zip(sample, (point.y, point.y, point.x, point.x), strict=True)
            sample = TuningData(*(signal - centre for signal, centre in signals))
        window = self.noise.moved(state.window, sample)
        Q_yw, info = self.noise.penalties(k, window, state.Q_yw)
        command, loss = self._first(k, now, Q_yw, estimate, r, state.u_previous)
        info = {"Q_yw": Q_yw, "loss": loss, **info}
        w_mean = estimate.info["w_mean"] if self.uses_mean else state.w_mean_previous
        return TunedState(x_hat, command.u, Q_yw, window, w_mean), self._physical(command, info)

    def warm_up(self) -> None:
        """Compile the kernels of a step before the design is sent to workers."""
        self._try(self.noise.start)


def _linear(
    law: TrackingLaw, x: Float[Array, "runs nx"], w: Float[Array, "Np ny"]
) -> tuple[Float[Array, "runs nu"], Float[Array, " runs"]]:
    """Return the first inputs and the minimal costs for constant gains."""
    # The reference is the same for all runs.
    ahead = w.reshape(1, -1)
    e = mv(law.E_w, ahead) + law.e_0 - mv(law.E_x, x)
    return mv(law.K_w, ahead) + law.u_0 - mv(law.K_x, x), (e * e).sum(axis=1)
