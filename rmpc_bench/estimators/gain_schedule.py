"""Linear filter with precomputed gains, used by every estimator whose gains do not depend on the data.

Designs `predictor_schedule` from given gains, `riccati_schedule` by a Riccati recursion with a modified covariance,
        `mixed_schedule` by a recursion for a covariance and an ellipsoid.

Model   x_pred(k+1) = F_k x_pred(k) + B_k u(k) + f_k + K_k e(k),  x_hat(k) = x_pred(k) + L_k e(k),
        e(k) = y(k) - C_k x_pred(k) - d_k;  K_k = F_k L_k for a filter, L_k = 0 for a one-step predictor.
Missing An output that is missing (NaN) has e = 0 in these sums: the filter predicts, with the gains of the schedule.  P
        and S stay those of the schedule, so that P is too small after a missing measurement; `bridging` computes them
        again.  A filter with a set M does not bridge: the set would no longer contain the error.
Cost    Five small matrix-vector products per run and step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import NoiseSets, stochastic_sets
from rmpc_bench.numerics.kl_ball import LARGEST, Inflation
from rmpc_bench.numerics.linalg import at_sample, mv
from rmpc_bench.numerics.mixed_step import MixedStep, Prior, Rule, mixed_step, root_weight, sum_root
from rmpc_bench.numerics.riccati import error_radius, filter_step, predicted_root, unmeasured_step
from rmpc_bench.numerics.square_root import covariance_of, root_of
from rmpc_bench.types import Array, CompiledFilter, DesignError, Estimate, Estimator, GainSchedule, Model, Status

OK = np.int8(Status.OK)

Form: TypeAlias = Literal["filter", "predictor"]


class FilterState(NamedTuple):
    """State of the filter between steps."""

    x_pred: Float[Array, "runs nx"]
    e: Float[Array, "runs ny"]
    """Innovation of the last correction, 0 where the measurement was missing."""


@dataclass(frozen=True, eq=False)
class GainScheduleFilter(Estimator):
    """A linear filter with precomputed gains; axis 0 of every array is k and has length 1 if the array is constant.

    Parameters
    ----------
    x0 : (nx,) prediction before the first measurement
    F, B, C : (1 or samples, ...) model matrices
    K, L : (1 or samples, nx, ny) gains of the prediction and of the correction
    P : (1 or samples, nx, nx) covariance of x_hat - x, None if the design reports none
    extra : further series of the design, axis 0 = k
    f, d : (1 or samples, nx), (1 or samples, ny) constant parts, None if they are zero
    remarks : notes on this design that `rmpc-bench check` prints
    M : (1 or samples, nx, nx) shape matrix of a set that contains x_hat - x, None if the design reports none
    sets : sets of the noises on which M or P is based, None for those of the model
    uncertainty_scale : factor of the uncertainty that the design guards against, None if it guards against none
    S : (1 or samples, ny, ny) covariance of the innovation, None if the design reports none
    root : (samples, nx, nx) roots of the covariance P_pred of the recursion, None if it has none
    """

    x0: Float[Array, " nx"]
    F: Float[Array, "kF nx nx"]
    B: Float[Array, "kB nx nu"]
    C: Float[Array, "kC ny nx"]
    K: Float[Array, "kK nx ny"]
    L: Float[Array, "kL nx ny"]
    P: Float[Array, "kP nx nx"] | None
    extra: Mapping[str, Array] = field(default_factory=dict)
    f: Float[Array, "kf nx"] | None = None
    d: Float[Array, "kd ny"] | None = None
    remarks: tuple[str, ...] = ()
    M: Float[Array, "kM nx nx"] | None = None
    sets: NoiseSets | None = None
    uncertainty_scale: float | None = None
    S: Float[Array, "kS ny ny"] | None = None
    root: Float[Array, "k nx nx"] | None = None

    has_compiled_form = True

    @property
    def bridges_missing(self) -> bool:
        """Whether a missing measurement is replaced by its prediction."""
        return self.M is None

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """The innovation, and its covariance where the design has one."""
        ny = self.C.shape[1]
        return {"e": (ny,)} if self.S is None else {"e": (ny,), "S": (ny, ny)}

    def init(self, n_runs: int) -> FilterState:
        """Start every run at ``x0``."""
        return FilterState(np.tile(self.x0, (n_runs, 1)), np.zeros((n_runs, self.C.shape[1])))

    def correct(self, k: int, state: FilterState, y: Float[Array, "runs ny"]) -> tuple[FilterState, Estimate]:
        """Use y(k): x_hat = x_pred + L e."""
        e = y - mv(at_sample(self.C, k), state.x_pred)
        if self.d is not None:
            e = e - at_sample(self.d, k)
        used, missing = e, np.isnan(y)
        if self.bridges_missing and missing.any():
            used = np.where(missing, 0.0, e)
        x_hat = state.x_pred + mv(at_sample(self.L, k), used) if self._corrects else state.x_pred
        P = None if self.P is None else at_sample(self.P, k)
        M = None if self.M is None else at_sample(self.M, k)
        info = {"e": e}
        if self.S is not None:
            S = at_sample(self.S, k)
            info["S"] = np.broadcast_to(S, (len(y), *S.shape))
        return FilterState(state.x_pred, used), Estimate(x_hat, P, M, np.full(len(y), OK), info)

    def predict(self, k: int, state: FilterState, u: Float[Array, "runs nu"]) -> FilterState:
        """Predict k+1: x_pred+ = F x_pred + B u + K e."""
        x_pred = mv(at_sample(self.F, k), state.x_pred)
        if self._is_driven:
            x_pred = x_pred + mv(at_sample(self.B, k), u)
        x_pred = x_pred + mv(at_sample(self.K, k), state.e)
        if self.f is not None:
            x_pred = x_pred + at_sample(self.f, k)
        return FilterState(x_pred, state.e)

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


def over_time(matrices: Sequence[Array]) -> Array:
    """Stack the matrices of all k; axis 0 has length 1 if all are the same object."""
    return np.array(matrices[:1] if all(matrix is matrices[0] for matrix in matrices) else matrices)


def constant_part(vectors: Sequence[Array]) -> Array | None:
    """Stack the constant parts of all k; None if they are zero."""
    stacked = over_time(vectors)
    return stacked if stacked.any() else None


def predictor_schedule(
    models: Sequence[LinearModel],
    x0: Float[Array, " nx"],
    K: Sequence[Array],
    P: Sequence[Array],
    *,
    F: Sequence[Array] | None = None,
    extra: Mapping[str, Array] | None = None,
    remarks: tuple[str, ...] = (),
) -> GainScheduleFilter:
    """Create a one-step predictor: x_hat(k) = x_pred(k) does not use y(k).

    Parameters
    ----------
    models : the nominal model at k = 0..N, for B, C and the constant parts
    x0 : (nx,) prediction before the first measurement
    K, P : gains, and covariances of x_pred - x, at k = 0..N
    F : transition matrices (default: A of the models)
    extra, remarks : as in `GainScheduleFilter`
    """
    nx, ny = models[0].nx, models[0].ny
    return GainScheduleFilter(
        x0=x0,
        F=over_time([model.A for model in models] if F is None else F),
        B=over_time([model.B for model in models]),
        C=over_time([model.C for model in models]),
        K=over_time(K),
        L=np.zeros((1, nx, ny)),
        P=over_time(P),
        extra=extra or {},
        f=constant_part([model.f0 for model in models]),
        d=constant_part([model.d0 for model in models]),
        remarks=remarks,
    )


def riccati_schedule(
    model: Model,
    n_steps: int,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    inflate: Callable[[int, Array], Inflation],
    form: Form = "filter",
    use_y0: bool = True,
    growth: float = 1.0,
) -> GainScheduleFilter:
    """Run a Riccati recursion of roots; that of the prediction is replaced by ``inflate(k, root)`` before it is used.

    Parameters
    ----------
    model : design model
    n_steps : N; gains are computed for k = 0..N
    x0 : (nx,) prediction of x(0)
    P0 : (nx, nx) covariance of its error
    inflate : maps k and a root of P_pred to that of the covariance V that replaces P_pred, and its multiplier theta
    form : `filter` uses y(k) for x_hat(k); `predictor` does not, and its P is V
    use_y0 : whether to use y(0)
    growth : factor of A P A' in the covariance of the prediction

    Raises
    ------
    DesignError
        If the innovation covariance is singular at some step, a covariance exceeds 1e100, or the noises of the model
        are correlated.
    """
    models = uncorrelated(model, n_steps)
    roots, V, P, K, L, theta = [root_of(P0)], [], [], [], [], []
    for k, now in enumerate(models):
        try:
            inflation = inflate(k, roots[-1])
            counts = k > 0 or use_y0
            take = filter_step if counts else unmeasured_step
            step = take(now.A, now.C, now.Q_w, now.R_v, inflation.root, growth)
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
    predictor = predictor_schedule(models, x0, K, list(of_V), extra=extra)
    predictor = replace(predictor, sets=stochastic_sets(model), S=over_time(S), root=np.array(roots[:-1]))
    return predictor if form == "predictor" else replace(predictor, L=np.array(L), P=covariance_of(np.array(P)))


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

    Parameters
    ----------
    model : design model
    n_steps : N; gains are computed for k = 0..N
    x0 : (nx,) prediction of x(0)
    P0 : (nx, nx) covariance of the stochastic part of its error; None omits all stochastic noises
    M0 : (nx, nx) shape matrix of the set of the bounded part
    sets : sets of the bounded noises
    rule : computation of the weight q of a correction, see `mixed_step`
    use_y0 : whether to use y(0)

    Raises
    ------
    DesignError
        If the innovation has no noise at some step, a matrix exceeds 1e100, or the noises of the model are correlated.
    """
    models, counted = uncorrelated(model, n_steps), 0.0 if P0 is None else 1.0
    P_roots, M_roots = [root_of(np.zeros_like(M0) if P0 is None else P0)], [root_of(M0)]
    steps, p, q = list[MixedStep](), [], 1.0
    for k, now in enumerate(models):
        prior = Prior(now.C, P_roots[-1], M_roots[-1], counted * root_of(now.R_v), root_of(sets.measurement(k)))
        try:
            step = mixed_step(prior, rule, q) if k > 0 or use_y0 else prior.kept()
        except np.linalg.LinAlgError:
            refuse_overflow(covariance_of(np.array(P_roots)))
            refuse_overflow(covariance_of(np.array(M_roots)), "set")
            raise singular_innovation(k) from None
        moved, noise = now.A.dot(step.M_root), root_of(sets.process(k))
        p.append(root_weight(moved, noise))  # (23)
        P_roots.append(predicted_root(now.A, counted * now.Q_w, step.P_root))  # (17)
        M_roots.append(sum_root(moved, noise, p[-1]))  # (18)
        q = step.q
        steps.append(step)
    P_pred, M_pred = covariance_of(np.array(P_roots)), covariance_of(np.array(M_roots))
    refuse_overflow(P_pred)
    refuse_overflow(M_pred, "set")
    covariance = {} if P0 is None else {"P_pred": P_pred[:-1]}
    extra = {**covariance, "M_pred": M_pred[:-1], "p": np.array(p), "q": np.array([each.q for each in steps])}
    K, P = [now.A.dot(step.L) for now, step in zip(models, steps, strict=True)], [step.P for step in steps]
    predictor = predictor_schedule(models, x0, K, P, extra=extra)
    return replace(
        predictor,
        L=np.array([step.L for step in steps]),
        P=None if P0 is None else np.array(P),
        M=np.array([step.M for step in steps]),
        sets=sets,
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
