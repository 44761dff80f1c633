"""Robust filter by regularised least squares with bounded data uncertainty.

Model   x(k+1) = (A + M Delta E_f) x(k) + B u(k) + f0 + (Bw + M Delta E_g) w(k),  y(k) = C x(k) + d0 + v~(k), with any
        Delta of norm at most 1, M = [H_A H_Bw], E_f = [G_x; 0], E_g = [0; G_w]; w and v~ white and uncorrelated.
        Every step estimates (x(k), w(k)) from y(k+1) by least squares under the worst Delta.  P is no bound of the
        error covariance.
Source  Sayed, IEEE Trans. Automatic Control 46 (2001) 998-1013: time- and measurement-update form; here E_f' E_g = 0,
        so that G does not change.  `lam: search` is its Step 1; lam then depends on the data.
Assumed `lam: approximate` uses (1 + alpha) lam_l with lam_l = |M' C' R^-1 C M|, the paper's approximation without a
        search.  The search is exact between (1 + 1e-9) lam_l and 1e9 lam_l; the paper gives no upper end.
        The filter ignores uncertainty in C, Bv, Dw and Dv; use R to account for H_Dv.  Means enter through f0 and d0
        without uncertainty.
Limit   C M = 0 or no uncertainty gives the Kalman filter.
Missing A run with gaps has its own gains and P from then on.  The step to k+1 keeps the lam of all outputs, which is
        above that of every part of them; `lam: search` does not bridge missing measurements.
Digits  `lam: search` forms P at every step: variances have relative errors of 1e-10 at P(0) = 1e8 R and 4e-4 at 1e14 R
        (measured).
Cost    As every gain schedule; with a search 35 us per run and step for two states and one output.
Fails   Design error: R is singular although lam is needed, w~ and v~ are correlated, or a given lam is below lam_l.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.bridging import Gains, RunByRun, with_outputs
from rmpc_bench.estimators.gain_schedule import Form, GainScheduleFilter, refuse_overflow, schedule_of
from rmpc_bench.models.uncertain_linear import DesignSystem, design_systems
from rmpc_bench.numerics.bounded_data import BoundedStep
from rmpc_bench.numerics.divergence import LARGEST
from rmpc_bench.numerics.linalg import as_covariance, at_sample, check_signal, driven, mv, symmetrise
from rmpc_bench.numerics.riccati import filter_step, predicted_root
from rmpc_bench.numerics.square_root import corrected, covariance_of, root_of
from rmpc_bench.types import Array, DesignError, Estimate, Estimator, Matrix, Model, NonNegative, Positive, as_estimate

EQUATION = r"""\min_{x, w} \max_{\Vert \Delta \Vert \le 1} \Vert x -
\hat x_k \Vert_{P_k^{-1}}^2 + \Vert w \Vert_{Q_w^{-1}}^2 + \Vert y_{k+1} - C x_{k+1}(x, w, \Delta) \Vert_{R^{-1}}^2"""


class Multiplier(NamedTuple):
    """Terms of one step that follow from the uncertainty and do not depend on P."""

    lam: float  # multiplier; 0 if the uncertainty has no effect on y(k+1)
    surplus: Float[Array, "ny ny"]  # matrix subtracted from R at k+1, C M M' C' / lam
    noise: Float[Array, "nx nx"]  # covariance of the modified noise in x(k+1)


class SearchState(NamedTuple):
    """State of the filter with a search between steps."""

    x_hat: Float[Array, "runs nx"]  # latest estimate; before the first measurement the prediction
    root: Float[Array, "runs nx nx"]  # root of P
    known: Float[Array, "runs nx"]  # B u and the constant part of the step from that estimate


@dataclass(frozen=True, eq=False)
class SayedSearch(Estimator):
    """The filter whose lam minimises G(lam) for the data of every run; a step without an effect on y(k+1) is None."""

    systems: list[DesignSystem]
    steps: list[BoundedStep | None]
    R: list[Array]
    x0: Float[Array, " nx"]
    P0: Float[Array, "nx nx"]

    uncertainty_scale = 1.0

    @property
    def reports(self) -> Mapping[str, tuple[int, ...]]:
        """The multiplier of the step to k, 0 where the uncertainty has no effect."""
        return {"lam": (1,)}

    @property
    def form(self) -> Form:
        """x_hat(k) uses y(k)."""
        return "filter"

    def init(self, n_runs: int) -> SearchState:
        """Start every run at ``x0``."""
        x_hat = np.tile(self.x0, (n_runs, 1))
        return SearchState(x_hat, np.tile(root_of(self.P0), (n_runs, 1, 1)), np.zeros_like(x_hat))

    def correct(self, k: int, state: SearchState, y: Float[Array, "runs ny"]) -> tuple[SearchState, Estimate]:
        """Choose lam with y(k), predict from the sample before, and use y(k)."""
        now = at_sample(self.systems, k).nominal
        check_signal("y", y, len(state.x_hat), len(now.C))
        x_pred, root, R, lam = self._predicted(k, state, y)
        e = y - now.d0 - mv(now.C, x_pred)
        found = corrected(now.C, root_of(R), root)
        after = SearchState(x_pred + mv(found.gain, e), found.root, state.known)
        return after, as_estimate(Estimate(after.x_hat, covariance_of(after.root), info={"e": e, "lam": lam[:, None]}))

    def predict(self, k: int, state: SearchState, u: Float[Array, "runs nu"]) -> SearchState:
        """Keep the known part of the step; the rest follows with y(k+1)."""
        now = at_sample(self.systems, k).nominal
        return state._replace(known=driven(now.B, u) + now.f0)

    def _predicted(self, k: int, state: SearchState, y: Array) -> tuple[Array, Array, Array, Array]:
        """Return x_pred, the root of P_pred, the R to use and lam at k; P is formed, which costs digits."""
        R, lam = np.broadcast_to(self.R[k], (len(y), *self.R[k].shape)), np.zeros(len(y))
        if k == 0:
            return state.x_hat, state.root, R, lam
        before, now, step = self.systems[k - 1].nominal, self.systems[k].nominal, self.steps[k - 1]
        nominal = mv(before.A, state.x_hat) + state.known
        if step is None:
            return nominal, predicted_root(before.A, before.Q_w, state.root), R, lam
        P = covariance_of(state.root)
        mu = step.multiplier(state.x_hat, P, y - now.d0 - mv(now.C, nominal))
        F, P_pred, R = step.advance(mu, P)
        return mv(F, state.x_hat) + state.known, root_of(P_pred), R, 1.0 / mu


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    alpha: NonNegative = 0.5,
    lam: Literal["approximate", "search"] | Positive = "approximate",
    R: Matrix | None = None,
    form: Form = "filter",
) -> GainScheduleFilter | SayedSearch:
    """Sayed's robust filter; equal to the Kalman filter if the model has no uncertainty.

    Parameters
    ----------
    model : uncertain model
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    alpha : relative excess of lam over its lower bound, for `lam: approximate`
    lam : `approximate` is (1 + alpha) times the lower bound; `search` minimises G(lam) of (11) at every step of every
        run
    R : (ny, ny) covariance of the measurement noise in the design (default: that of the model)
    form : `filter` uses y(k) for x_hat(k), `predictor` does not

    Raises
    ------
    DesignError
        If R is not admissible or singular, the noises are correlated, P overflows, lam is not above its lower bound, or
        a search is combined with the predictor form.
    """
    systems = design_systems(model, n_steps)
    if any(now.nominal.S_wv.any() for now in systems):
        raise DesignError("this filter needs uncorrelated process and measurement noise; use kalman-predictor")
    R_given = None if R is None else as_covariance(R, systems[0].nominal.ny, "R")
    noise = [now.nominal.R_v if R_given is None else R_given for now in systems]
    if lam == "search":
        if form == "predictor":
            raise DesignError("a search uses y(k+1) for the step to k+1; choose filter, or another lam", "form")
        return _searching(systems, noise, x0, P0)
    given = None if isinstance(lam, str) else lam
    roots, P, L, K, F, chosen_at, R_hats = [root_of(P0)], [], [], [], [], list[Multiplier](), [noise[0]]
    last: tuple[DesignSystem, DesignSystem] | None = None
    for k, now in enumerate(systems):
        try:
            step = filter_step(now.m.A, now.m.C, now.nominal.Q_w, R_hats[-1], roots[-1])
        except np.linalg.LinAlgError:
            refuse_overflow(covariance_of(np.array(roots)))
            raise DesignError(f"the covariance of the innovation is singular at k = {k}: set R", "R") from None
        after = min(k + 1, n_steps)
        if last is None or now is not last[0] or systems[after] is not last[1]:
            last = now, systems[after]
            chosen = _multiplier(now, systems[after].m.C, noise[after], alpha, given)
        R_hats.append(noise[after] - chosen.surplus)
        transition, root_next = _predict(now, chosen, step.root)
        P.append(step.root)
        L.append(step.L)
        F.append(transition)
        K.append(transition.dot(step.L))
        chosen_at.append(chosen)
        roots.append(root_next)
    P_pred = covariance_of(np.array(roots))
    refuse_overflow(P_pred)
    models = [now.nominal for now in systems]
    extra = {"P_pred": P_pred[:-1], "lam": np.array([each.lam for each in chosen_at])}
    corrects = form == "filter"
    return schedule_of(
        models,
        x0,
        K,
        covariance_of(np.array(P)) if corrects else P_pred[:-1],
        L=L if corrects else None,
        F=F,
        extra=extra,
        uncertainty_scale=1.0,
        root=np.array(roots[:-1]),
        recursion=RunByRun(partial(_of_one_run, list(zip(systems, R_hats, chosen_at, strict=False)), corrects)),
    )


def _of_one_run(
    steps: list[tuple[DesignSystem, Array, Multiplier]], corrects: bool, k: int, root: Array, there: Array
) -> Gains:
    """Return the gains of a run in which measurements are missing."""
    now, R, chosen = steps[k]
    C, R = with_outputs(now.m.C, R, there)
    step = filter_step(now.m.A, C, now.nominal.Q_w, R, root)
    F, root_next = _predict(now, chosen, step.root)
    return Gains(step.L, F.dot(step.L), root_next, covariance_of(step.root if corrects else root), F=F)


def _bound(CM: Array, R: Array) -> float:
    """Return the lower bound of lam, |M' C' R^-1 C M|; C and R are those of k+1."""
    try:
        bound = float(np.linalg.norm(CM.T.dot(np.linalg.inv(R)).dot(CM), 2))
    except np.linalg.LinAlgError:
        raise DesignError(_SINGULAR, "R") from None
    if not 0.0 < bound < LARGEST:
        raise DesignError(_SINGULAR, "R")
    return bound


def _visible(now: DesignSystem, C: Array) -> Array:
    """Return C M, the effect of the uncertainty on y(k+1); C is that of k+1."""
    m = now.m
    CM: Array = C.dot(np.hstack([m.H_A if m.G_x.any() else 0.0 * m.H_A, m.H_Bw if m.G_w.any() else 0.0 * m.H_Bw]))
    return CM


def _rest(now: DesignSystem) -> Array:
    """Return the contribution of v to the covariance of the process noise."""
    rest: Array = now.nominal.Q_w - now.m.Bw.dot(now.W).dot(now.m.Bw.T)
    return rest


def _multiplier(now: DesignSystem, C: Array, R: Array, alpha: float, given: float | None) -> Multiplier:
    """Compute lam, Step 1, and the terms that follow from it; C and R are those of k+1."""
    m, CM = now.m, _visible(now, C)
    if not CM.any():
        return Multiplier(0.0, np.zeros_like(R), now.nominal.Q_w)
    bound = _bound(CM, R)
    if given is not None and not bound < given < LARGEST:
        raise DesignError(f"must be above |M' C' R^-1 C M| = {bound:.6g}", "lam")
    lam = (1.0 + alpha) * bound if given is None else given
    if not lam < LARGEST:
        raise DesignError(_SINGULAR, "R")
    noise = symmetrise(m.Bw.dot(_shrunk(now.W, m.G_w, lam)).dot(m.Bw.T) + _rest(now))
    return Multiplier(lam, symmetrise(CM.dot(CM.T)) / lam, noise)


def _searching(
    systems: list[DesignSystem], R: list[Array], x0: Float[Array, " nx"], P0: Float[Array, "nx nx"]
) -> SayedSearch:
    steps: list[BoundedStep | None] = []
    for k, (now, after) in enumerate(zip(systems[:-1], systems[1:], strict=True)):
        if k and now is systems[k - 1] and after is now:
            steps.append(steps[-1])
            continue
        m, CM = now.m, _visible(now, after.m.C)
        if CM.any():
            terms = m.A, m.G_x, m.Bw, m.G_w, now.W, _rest(now), after.m.C, R[k + 1]
            steps.append(BoundedStep(*terms, HH=symmetrise(CM.dot(CM.T)), lam_l=_bound(CM, R[k + 1])))
        else:
            steps.append(None)
    return SayedSearch(systems, steps, R, x0, P0)


def _predict(now: DesignSystem, chosen: Multiplier, root: Array) -> tuple[Array, Array]:
    """Return the transition matrix and the root of P_pred of k+1 from that of P(k), Steps 2 and 3."""
    A, G = now.m.A, now.m.G_x
    F = A
    if chosen.lam:
        # (P^-1 + lam G'G)^-1 is P after a measurement of G x with noise of covariance I / lam.
        root = corrected(G, np.eye(len(G)) / chosen.lam**0.5, root).root
        F = A - chosen.lam * A.dot(root).dot(G.dot(root).T).dot(G)
    return F, predicted_root(A, chosen.noise, root)


_SINGULAR = "the covariance of the measurement noise is singular, but lam needs its inverse: set R of this filter"


def _shrunk(P: Float[Array, "n n"], G: Float[Array, "s n"], lam: float) -> Float[Array, "n n"]:
    """Return (P^-1 + lam G'G)^-1, also of a singular P."""
    PG = P.dot(G.T)
    shrunk: Array = symmetrise(P - PG.dot(np.linalg.solve(np.eye(len(G)) / lam + G.dot(PG), PG.T)))
    return shrunk
