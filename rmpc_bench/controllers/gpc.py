"""Generalised predictive control: positional form, no constraints, output weight constant or adapted to the noise.

Contents
    1  law with a constant output weight                       Gpc
    2  law with an output weight adapted to the noise          TunedGpc
    3  design and checks of the keys                           design, _noise

Model   At every k minimise over u(k)..u(k+Np-1) the sum over j = 1..Np of
        |Q_yw (y(k+j) - r(k+j))|^2 + |Q_u u(k+j-1)|^2, predicted from x_hat(k) with one model over the horizon, and
        apply u(k) (7).  Q_yw and Q_u are roots: the weights are Q_yw' Q_yw and Q_u' Q_u.  The cost weighs the inputs,
        not their increments: a reference that needs a constant input is reached with an offset.  With a model that
        has an operating point, u stands for u - u_op throughout, and `lp-noise` takes deviations from it.
        A state-dependent model is evaluated at x_hat(k-1), at k = 0 at x_hat(0); a time-varying model at k.
        The predictions include the constant parts of the model and, if the estimator estimates it, the mean of the
        process noise (`w_mean` of the estimate), which is held over the horizon.
Source  belda2017, section III; order of the steps as in its section VI.
Tuning  `constant`, or `lp-noise` (noise_tuning.py), which computes Q_yw(k) from recent estimates and measurements.
Limit   Without a reference lqr with horizon = Np, Q_x = C' Q_yw' Q_yw C and R_u = Q_u' Q_u.  With Np = 1, Q_u = 0 and
        C B square, y(k+1) = r(k+1).
Cost    With constant weights and a constant linear model two small matrix-vector products per run and step.  Otherwise
        a square-root recursion over the horizon, about 10 us for six states, four inputs and Np = 10.
Fails   Design error if the cost does not determine the inputs, for example Q_u = 0 with more inputs than outputs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.noise_tuning import ConstantTuning, LpNoise, NoiseTuning, TuningData
from rmpc_bench.controllers.prediction import Frozen, frozen, with_mean, with_output
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.state_dependent import StateDependentModel
from rmpc_bench.numerics.linalg import as_matrix, mv
from rmpc_bench.numerics.tracking import SMALLEST, TrackingLaw, gains, track
from rmpc_bench.types import Array, Command, Controller, DesignError, Estimate, Estimator, Horizon, Matrix, Status

OK = np.int8(Status.OK)


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
    """The law with a constant output weight; create it with `design`.

    Parameters
    ----------
    model : design model, linear or state-dependent
    Np : prediction horizon [samples]
    Q_yw : root of the output weight
    R_u : upper triangular root of the input weight
    gains : the constant law, None if the law varies with k or with the state
    uses_mean : whether the predictions use the estimated mean of the process noise
    """

    model: Any
    Np: int
    Q_yw: Float[Array, "ny ny"]
    R_u: Float[Array, "nu nu"]
    gains: TrackingLaw | None
    uses_mean: bool

    @property
    def preview(self) -> int:
        """Samples r(k)..r(k+Np)."""
        return self.Np + 1

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """What the info of a command has."""
        return {"Q_yw": self.Q_yw.shape, "loss": ()}

    @property
    def cost_per_step(self) -> float:
        """Time of the recursion, and of a linearisation run by run [s]."""
        return 0.0 if self.gains is not None else 1.2e-6 * self.Np + (3e-4 if self._offsets else 0.0)

    def init(self, n_runs: int) -> GpcState | TunedState:
        """Start with a previous estimate of 0, which the law does not use at k = 0."""
        return GpcState(np.zeros((n_runs, self._nx)), np.zeros((n_runs, len(self.R_u))))

    def control(
        self,
        k: int,
        state: Any,
        y: Float[Array, "runs ny"],
        estimate: Estimate,
        r: Float[Array, "preview ny"],
    ) -> tuple[Any, Command]:
        """Apply the first input of the minimiser."""
        x_hat = estimate.x_hat
        if self.gains is not None:
            d = self._frozen(k, x_hat, state.u_previous).d
            u, loss = _linear(self.gains, self._extended(estimate), r[1:] - d)
        else:
            now = self._frozen(k, state.x_previous if k else x_hat, state.u_previous)
            u, loss = self._first(now, self.Q_yw[None], estimate, r)
        info = {"Q_yw": np.broadcast_to(self.Q_yw, (len(u), *self.Q_yw.shape)), "loss": loss}
        return GpcState(x_hat, u), Command(self._physical(u), np.full(len(u), OK), info)

    def warm_up(self) -> None:
        """Compile the kernels of a step before the design is sent to workers."""
        if self.gains is None:
            self._try(0)

    def _try(self, k: int) -> None:
        ny = len(self.Q_yw)
        x_hat = np.zeros((1, self._nx))
        nothing = Estimate(x_hat, None, None, np.full(1, OK), {"w_mean": x_hat})
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

    def _physical(self, u: Float[Array, "runs nu"]) -> Float[Array, "runs nu"]:
        """Return the inputs; `u` are their deviations from the operating point."""
        return u if self.model.operating_point is None else u + self.model.u_op

    def _first(
        self,
        now: Frozen,
        Q_yw: Float[Array, "weights ny ny"],
        estimate: Estimate,
        r: Float[Array, "preview ny"],
    ) -> tuple[Float[Array, "runs nu"], Float[Array, " runs"]]:
        """Return the first inputs and the minimal costs."""
        now = with_mean(now) if self.uses_mean else now
        A, B = (matrix if matrix.ndim == 3 else matrix[None] for matrix in (now.A, now.B))
        return track(A, B, now.f, now.C, Q_yw, self.R_u, r[1:] - now.d, self._extended(estimate))

    def _extended(self, estimate: Estimate) -> Float[Array, "runs n"]:
        """Return the estimate, followed by the estimated mean of the process noise if it is used."""
        if self._offsets:
            # The states of `with_output`: its output at k has no effect.
            nothing = np.zeros((len(estimate.x_hat), len(self.Q_yw)))
            return np.hstack([estimate.x_hat, nothing, np.ones((len(nothing), 1))])
        return np.hstack([estimate.x_hat, estimate.info["w_mean"]]) if self.uses_mean else estimate.x_hat


@dataclass(frozen=True, eq=False)
class TunedGpc(Gpc):
    """The law with an output weight adapted to the noise; create it with `design`.

    Parameters
    ----------
    noise : tuning of the output weight
    """

    noise: NoiseTuning

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
        self,
        k: int,
        state: Any,
        y: Float[Array, "runs ny"],
        estimate: Estimate,
        r: Float[Array, "preview ny"],
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
        u, loss = self._first(now, Q_yw, estimate, r)
        info = {"Q_yw": Q_yw, "loss": loss, **info}
        w_mean = estimate.info["w_mean"] if self.uses_mean else state.w_mean_previous
        after = TunedState(x_hat, u, Q_yw, window, w_mean)
        return after, Command(self._physical(u), np.full(len(u), OK), info)

    def warm_up(self) -> None:
        """Compile the kernels of a step before the design is sent to workers."""
        self._try(self.noise.start)


def design(
    model: Any,
    n_steps: int | None = None,
    estimator: Estimator | None = None,
    *,
    Np: Horizon,
    Q_yw: Matrix,
    Q_u: Matrix,
    tuning: ConstantTuning | LpNoise = ConstantTuning(),  # noqa: B008 - frozen, so it cannot be shared by mistake
) -> Gpc:
    """Generalised predictive controller.

    Parameters
    ----------
    model : prediction model, linear or state-dependent; the nominal part of an uncertain model
    n_steps : number of control periods; without it, a model that may vary is treated as varying
    estimator : estimator of the method; the predictions use the mean of the process noise if it estimates one, and
        `lp-noise` starts after the window of an estimator with a window is full
    Np : prediction horizon [samples]
    Q_yw : root of the weight of the output error: a number, a diagonal or a matrix
    Q_u : root of the weight of the input: a number, a diagonal or a matrix
    tuning : `{kind: constant}` keeps Q_yw, `{kind: lp-noise, ..}` adapts Q_yw to estimated bounds of the noise

    Raises
    ------
    DesignError
        If a size is inconsistent, the bounds are in the wrong order, the cost does not determine the inputs, or the
        estimator estimates the mean of the process noise of a state-dependent model.
    """
    model = _constant(model, n_steps)
    uses_mean = estimator is not None and estimator.estimates_mean
    if uses_mean and isinstance(model, StateDependentModel):
        raise DesignError("does not support an estimated mean of the process noise with a state-dependent model")
    now = model if isinstance(model, StateDependentModel) else model.at(0)
    outputs, inputs = _root("Q_yw", Q_yw, now.ny), _root("Q_u", Q_u, now.nu)
    R_u = np.linalg.qr(inputs)[1]
    if isinstance(tuning, ConstantTuning) and isinstance(model, LinearModel):
        fixed = with_mean(frozen(model)) if uses_mean else frozen(model)
        try:
            law = gains(fixed.A, fixed.B, fixed.f, fixed.C, outputs, inputs, Np)
        except ValueError as error:
            raise DesignError(f"{error}; choose another Q_u", "Q_u") from None
        return Gpc(model, Np, outputs, R_u, law, uses_mean)
    sizes = np.linalg.svd(inputs, compute_uv=False)
    if not sizes[-1] > SMALLEST * sizes[0]:
        raise DesignError("must be of full rank, unless both the model and Q_yw are constant", "Q_u")
    if isinstance(tuning, ConstantTuning):
        return Gpc(model, Np, outputs, R_u, None, uses_mean)
    if isinstance(model, StateDependentModel) and model.has_offsets:
        raise DesignError("does not support `at: trajectory` of the model; use constant", "tuning")
    return TunedGpc(model, Np, outputs, R_u, None, uses_mean, _noise(tuning, estimator, now.nx, now.ny))


def _root(name: str, root: Matrix, n: int) -> Float[Array, "n n"]:
    try:
        return as_matrix(root, n)
    except ValueError as error:
        raise DesignError(str(error), name) from None


def _constant(model: Any, n_steps: int | None) -> Any:
    """Return the linear model if it is the same at all k, otherwise the given model."""
    if isinstance(model, StateDependentModel | LinearModel) or n_steps is None:
        return model
    first = model.at(0)
    return first if all(model.at(k) is first for k in range(1, n_steps)) else model


def _noise(keys: LpNoise, estimator: Estimator | None, nx: int, ny: int) -> NoiseTuning:
    """Check the keys against the sizes of the model."""
    lower, upper = keys.bounds
    if not lower <= upper:
        raise DesignError(f"the lower bound {lower:g} must not exceed the upper bound {upper:g}", "tuning.bounds")
    most = max(ny, nx if keys.state_rows else 0)
    if keys.Ne2 + 1 < most:
        raise DesignError(
            f"must be at least {most - 1}: a fit of {most} coefficients needs as many samples", "tuning.Ne2"
        )
    return NoiseTuning(keys, keys.Ne2 + (0 if estimator is None else estimator.Ne), nx, ny)


def _linear(
    law: TrackingLaw, x: Float[Array, "runs nx"], w: Float[Array, "Np ny"]
) -> tuple[Float[Array, "runs nu"], Float[Array, " runs"]]:
    """Return the first inputs and the minimal costs for constant gains."""
    # The reference is the same for all runs.
    ahead = w.reshape(1, -1)
    e = mv(law.E_w, ahead) + law.e_0 - mv(law.E_x, x)
    return mv(law.K_w, ahead) + law.u_0 - mv(law.K_x, x), (e * e).sum(axis=1)
