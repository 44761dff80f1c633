"""Linear filter with precomputed gains, used by every estimator whose gains do not depend on the data.

Designs `schedule_of` from given gains, `riccati_schedule` by a Riccati recursion with a modified covariance,
        `mixed_schedule` by a recursion for a covariance and an ellipsoid.

Model   x_pred(k+1) = F_k x_pred(k) + B_k u(k) + f_k + K_k e(k),  x_hat(k) = x_pred(k) + L_k e(k),
        e(k) = y(k) - C_k x_pred(k) - d_k;  K_k = F_k L_k for a filter, L_k = 0 for a one-step predictor.
Missing A run with a missing output (NaN) leaves the schedule: gains, P, S and M then come from its own recursion, see
        `bridging`.  Without a recursion the filter does not bridge.
Cost    Five small matrix-vector products per run and step; 20 to 400 us more after a missing measurement (two states).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.estimators.bridging import BridgingState, MixedRecursion, Recursion, RiccatiRecursion, RunByRun
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import NoiseSets, stochastic_sets
from rmpc_bench.numerics.divergence import LARGEST, Inflation
from rmpc_bench.numerics.linalg import at_sample, driven, innovation, mv
from rmpc_bench.numerics.mixed_step import MixedStep, Rule
from rmpc_bench.numerics.riccati import error_radius, filter_step
from rmpc_bench.numerics.square_root import covariance_of, root_of
from rmpc_bench.types import (
    Array,
    CompiledFilter,
    DesignError,
    Estimate,
    Estimator,
    GainSchedule,
    Model,
    Status,
    as_estimate,
)

Form: TypeAlias = Literal["filter", "predictor"]


class FilterState(NamedTuple):
    """State of the filter between steps."""

    x_pred: Float[Array, "runs nx"]
    e: Float[Array, "runs ny"]  # innovation of the last correction


@dataclass(frozen=True, eq=False)
class GainScheduleFilter(Estimator):
    """A linear filter with precomputed gains; axis 0 of every array is k and has length 1 if the array is constant."""

    x0: Float[Array, " nx"]  # prediction before the first measurement
    F: Float[Array, "kF nx nx"]  # F, B, C: model matrices
    B: Float[Array, "kB nx nu"]
    C: Float[Array, "kC ny nx"]
    K: Float[Array, "kK nx ny"]  # K, L: gains of the prediction and of the correction
    L: Float[Array, "kL nx ny"]
    P: Float[Array, "kP nx nx"] | None  # covariance of x_hat - x, None if the design reports none
    extra: Mapping[str, Array] = field(default_factory=dict)  # further series of the design, axis 0 = k
    f: Float[Array, "kf nx"] | None = None  # f, d: constant parts, None if they are zero
    d: Float[Array, "kd ny"] | None = None
    remarks: tuple[str, ...] = ()  # notes on this design that `rmpc-bench check` prints
    M: Float[Array, "kM nx nx"] | None = None  # shape matrix of a set that contains x_hat - x, None if there is none
    sets: NoiseSets | None = None  # sets of the noises on which M or P is based, None for those of the model
    uncertainty_scale: float | None = None  # factor of the uncertainty that the design guards against, None if none
    S: Float[Array, "kS ny ny"] | None = None  # covariance of the innovation, None if the design reports none
    root: Float[Array, "k ..."] | None = None  # what the recursion keeps, mostly the roots of its P_pred
    recursion: Recursion | None = None  # gains of runs with missing measurements; None where they cannot go on
    P_is: Literal["covariance", "bound"] = "covariance"  # `bound` if P is an upper bound of the covariance

    has_compiled_form = True

    @property
    def bridges_missing(self) -> bool:
        """Whether runs with missing measurements have gains of their own."""
        return self.recursion is not None

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """The innovation, and its covariance where the design has one."""
        ny = self.C.shape[1]
        return {"e": (ny,)} if self.S is None else {"e": (ny,), "S": (ny, ny)}

    def init(self, n_runs: int) -> Any:
        """Start every run at ``x0``."""
        start = FilterState(np.tile(self.x0, (n_runs, 1)), np.zeros((n_runs, self.C.shape[1])))
        if self.recursion is None or self.root is None:
            return start
        kept = np.zeros((n_runs, *self.root.shape[1:]))
        return BridgingState(*start, np.zeros(n_runs, dtype=bool), kept, np.zeros_like(start.x_pred))

    def correct(self, k: int, state: Any, y: Float[Array, "runs ny"]) -> tuple[Any, Estimate]:
        """Use y(k): x_hat = x_pred + L e."""
        e = innovation(y, mv(at_sample(self.C, k), state.x_pred))
        if self.d is not None:
            e = e - at_sample(self.d, k)
        x_hat = state.x_pred + mv(at_sample(self.L, k), e) if self._corrects else state.x_pred
        P = None if self.P is None else at_sample(self.P, k)
        M = None if self.M is None else at_sample(self.M, k)
        info = {"e": e}
        if self.S is not None:
            S = at_sample(self.S, k)
            info["S"] = np.broadcast_to(S, (len(y), *S.shape))
        estimate = as_estimate(Estimate(x_hat, P, M, info=info))
        if self.recursion is None:
            return FilterState(state.x_pred, e), estimate
        missing = np.isnan(y)
        own = state.own | missing.any(axis=1)
        if own.any():
            return self._of_own_runs(k, state, missing, np.flatnonzero(own), estimate)
        return state._replace(e=e), estimate

    def _of_own_runs(
        self, k: int, state: BridgingState, missing: Array, rows: Int[Array, " own"], estimate: Estimate
    ) -> tuple[BridgingState, Estimate]:
        """Correct the runs with gains of their own; the estimates of the others are there."""
        assert self.recursion is not None and self.root is not None
        begun = state.own[rows].reshape(-1, *[1] * (self.root.ndim - 1))
        gains = self.recursion(k, np.where(begun, state.kept[rows], at_sample(self.root, k)), missing[rows])
        x_pred, e = state.x_pred[rows], np.where(missing[rows], 0.0, estimate.info["e"][rows])
        x_hat, status, shift = estimate.x_hat.copy(), estimate.status.copy(), mv(gains.K, e)
        x_hat[rows] = x_pred + mv(gains.L, e) if self._corrects else x_pred
        status[rows[~np.isfinite(gains.kept).reshape(len(rows), -1).all(axis=1)]] = Status.INFEASIBLE
        if gains.F is not None:
            shift = shift + mv(gains.F - at_sample(self.F, k), x_pred)
        after = BridgingState(
            state.x_pred, estimate.info["e"].copy(), state.own.copy(), state.kept.copy(), state.shift.copy()
        )
        after.e[rows], after.own[rows], after.kept[rows], after.shift[rows] = 0.0, True, gains.kept, shift
        P, M = (_with_rows(*each, rows, len(x_hat)) for each in ((estimate.P, gains.P), (estimate.M, gains.M)))
        S = _with_rows(estimate.info.get("S"), gains.S, rows, len(x_hat))
        info = {**estimate.info} if S is None else {**estimate.info, "S": S}
        return after, Estimate(x_hat, P, M, status, info)

    def predict(self, k: int, state: Any, u: Float[Array, "runs nu"]) -> Any:
        """Predict k+1: x_pred+ = F x_pred + B u + K e."""
        x_pred = mv(at_sample(self.F, k), state.x_pred)
        if self._is_driven:
            x_pred = x_pred + driven(at_sample(self.B, k), u)
        x_pred = x_pred + mv(at_sample(self.K, k), state.e)
        if self.f is not None:
            x_pred = x_pred + at_sample(self.f, k)
        if self.recursion is not None and state.own.any():
            x_pred[state.own] += state.shift[state.own]
        return state._replace(x_pred=x_pred)

    @property
    def form(self) -> Form:
        """Whether x_hat(k) uses y(k)."""
        return "filter" if self._corrects else "predictor"

    @property
    def gain_schedule(self) -> GainSchedule:
        """Matrices and gains over k."""
        return GainSchedule(self.x0, self.F, self.B, self.C, self.K, self.L, self.f, self.d)

    def compiled_form(self) -> CompiledFilter:
        """Return the arrays of the filter."""
        return CompiledFilter(self.gain_schedule, self.S)

    @cached_property
    def _corrects(self) -> bool:
        """Whether x_hat(k) uses y(k) at any k."""
        return bool(self.L.any())

    @cached_property
    def _is_driven(self) -> bool:
        """Whether the input has an effect in the model at any k."""
        return bool(self.B.any())

    def series(self) -> dict[str, Array]:
        """Gains, covariances and sets over k, and rho, the spectral radius of F - K C."""
        series = {name: matrices for name, matrices in (("P", self.P), ("M", self.M)) if matrices is not None}
        return {"K": self.K, "L": self.L, **series, "rho": error_radius(self.F, self.K, self.C), **self.extra}


def _with_rows(common: Array | None, own: Array | None, rows: Int[Array, " own"], n_runs: int) -> Array | None:
    """Return the matrix of every run: the common one, and that of its own for some rows."""
    if common is None or own is None:
        return common
    matrices = np.broadcast_to(common, (n_runs, *common.shape[-2:])).copy()
    matrices[rows] = own
    return matrices


def over_time(matrices: Sequence[Array] | Array) -> Array:
    """Stack the matrices of all k; axis 0 has length 1 if all are the same object."""
    return np.array(matrices[:1] if all(matrix is matrices[0] for matrix in matrices) else matrices)


def constant_part(vectors: Sequence[Array]) -> Array | None:
    """Stack the constant parts of all k; None if they are zero."""
    stacked = over_time(vectors)
    return stacked if stacked.any() else None


def schedule_of(
    models: Sequence[LinearModel],
    x0: Float[Array, " nx"],
    K: Sequence[Array],
    P: Sequence[Array] | Array | None,
    *,
    L: Sequence[Array] | None = None,
    F: Sequence[Array] | None = None,
    **others: Any,
) -> GainScheduleFilter:
    """Create a filter from gains and P over k and from other fields; without L, a predictor: x_hat(k) is x_pred(k).

    F is A of the models unless given.
    """
    return GainScheduleFilter(
        x0=x0,
        F=over_time([model.A for model in models] if F is None else F),
        B=over_time([model.B for model in models]),
        C=over_time([model.C for model in models]),
        K=over_time(K),
        L=np.zeros((1, models[0].nx, models[0].ny)) if L is None else np.array(L),
        P=None if P is None else over_time(P),
        f=constant_part([model.f0 for model in models]),
        d=constant_part([model.d0 for model in models]),
        **others,
    )


def riccati_schedule(
    model: Model,
    n_steps: int,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    inflate: Callable[[int, Array], Inflation] | None = None,
    form: Form = "filter",
    use_y0: bool = True,
    growth: float = 1.0,
) -> GainScheduleFilter:
    """Run a Riccati recursion of roots; that of the prediction is replaced by ``inflate(k, root)`` if there is one.

    `inflate` returns the root of the covariance V that replaces P_pred, and its multiplier theta.  A `predictor` does
    not use y(k) for x_hat(k), and its P is V.  `growth` is a factor of A P A' in the covariance of the prediction.  A
    DesignError says that an innovation covariance is singular, a covariance exceeds 1e100, or the noises are
    correlated.
    """
    models = uncorrelated(model, n_steps)
    roots, V, P, K, L, theta = [root_of(P0)], [], [], [], [], []
    for k, now in enumerate(models):
        try:
            inflation = inflate(k, roots[-1]) if inflate is not None else Inflation(roots[-1], 0.0)
            counts = k > 0 or use_y0
            step = filter_step(now.A, now.C, now.Q_w, now.R_v, inflation.root, growth, measured=counts)
        except np.linalg.LinAlgError:
            refuse_overflow(covariance_of(np.array(roots)))
            raise singular_innovation(k) from None
        V.append(inflation.root)
        theta.append(inflation.theta)
        P.append(step.root)
        L.append(step.L)
        K.append(step.K)
        roots.append(step.root_next)
    P_pred = covariance_of(np.array(roots))
    refuse_overflow(P_pred)
    of_V = covariance_of(np.array(V))
    extra = {"P_pred": P_pred[:-1], "V": of_V, "theta": np.array(theta)}
    S = [covariance_of(now.C.dot(each)) + now.R_v for now, each in zip(models, V, strict=True)]
    corrects = form == "filter"
    return schedule_of(
        models,
        x0,
        K,
        covariance_of(np.array(P)) if corrects else of_V,
        L=L if corrects else None,
        extra=extra,
        sets=stochastic_sets(model),
        S=over_time(S),
        root=np.array(roots[:-1]),
        recursion=RiccatiRecursion(models, inflate, corrects, use_y0, growth),
    )


def mixed_schedule(
    model: Model,
    n_steps: int,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"] | None,
    M0: Float[Array, "nx nx"],
    sets: NoiseSets,
    rule: Rule = "fixed-point",
    use_y0: bool = True,
) -> GainScheduleFilter:
    """Run a recursion for the covariance P of the stochastic error and the ellipsoid E(0, M) of the bounded error.

    P0 = None leaves out all stochastic noises; for `rule` see `mixed_step`.
    """
    models, counted = uncorrelated(model, n_steps), 0.0 if P0 is None else 1.0
    recursion = MixedRecursion(models, sets, rule, use_y0, counted)
    start = [root_of(np.zeros_like(M0) if P0 is None else P0), root_of(M0), np.ones_like(M0)]
    kept, steps, p = [np.array(start)], list[MixedStep](), []
    for k in range(n_steps + 1):
        try:
            step, after, weight = recursion.step(k, kept[-1])
        except np.linalg.LinAlgError:
            for noun, part in (("covariance", 0), ("set", 1)):
                refuse_overflow(covariance_of(np.array(kept)[:, part]), noun)
            raise singular_innovation(k) from None
        kept.append(after)
        steps.append(step)
        p.append(weight)
    P_pred, M_pred = (covariance_of(np.array(kept)[:, part]) for part in (0, 1))
    refuse_overflow(P_pred)
    refuse_overflow(M_pred, "set")
    covariance = {} if P0 is None else {"P_pred": P_pred[:-1]}
    extra = {**covariance, "M_pred": M_pred[:-1], "p": np.array(p), "q": np.array([each.q for each in steps])}
    return schedule_of(
        models,
        x0,
        [now.A.dot(step.L) for now, step in zip(models, steps, strict=True)],
        None if P0 is None else [step.P for step in steps],
        L=[step.L for step in steps],
        extra=extra,
        M=np.array([step.M for step in steps]),
        sets=sets,
        root=np.array(kept[:-1]),
        recursion=RunByRun(recursion.gains),
    )


def uncorrelated(model: Model, n_steps: int) -> list[LinearModel]:
    """Return the model at k = 0..N; raise a DesignError if process and measurement noise are correlated."""
    models = [model.at(k) for k in range(n_steps + 1)]
    if any(each.S_wv.any() for each in models):
        raise DesignError("this filter needs uncorrelated process and measurement noise; use kalman-predictor")
    return models


def singular_innovation(k: int) -> DesignError:
    """Return the error for a singular innovation at k."""
    return DesignError(f"the covariance of the innovation is singular at k = {k}: the model needs measurement noise")


def refuse_overflow(P_pred: Sequence[Array] | Array, noun: str = "covariance") -> None:
    """Raise a DesignError if a matrix is not finite or exceeds the range in which gains can be computed."""
    # False for NaN.
    fits = (np.abs(np.array(P_pred)) < LARGEST).all(axis=(1, 2))
    if not fits.all():
        raise DesignError(
            f"the {noun} of the prediction grows beyond {LARGEST:g} at k = {np.flatnonzero(~fits)[0]}: the "
            "measurements do not bound the error; choose less uncertainty or fewer steps"
        )
