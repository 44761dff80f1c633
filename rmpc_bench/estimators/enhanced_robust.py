"""Enhanced robust predictor: Riccati recursion with an error bound for uncertainty of norm at most 1.

Model   x(k+1) = (A + H_A F_x G_x) x + B u + f0 + (Bw + H_Bw F_w G_w) w + (Bv + H_Bv F_v G_v) v,
        y(k) = (C + H_C F_x G_x) x + d0 + (Dw + H_Dw F_w G_w) w + (Dv + H_Dv F_v G_v) v, F' F <= I, w and v white and
        uncorrelated; x_pred+ = Phi x_pred + B u + f0 + K (y - C x_pred - d0).
        While (47) holds (always with `rule: state`), P bounds the covariance of x_pred - x given any sequence of F.
        It does not bound the mean error.
Symbols a_x, a_w, a_v are 1/alpha_x, 1/alpha_w, 1/alpha_v; X = P11 bounds the covariance of x; Pc, Wc, Vc are P, W, V
        widened in Step 2; B = [Bw Bv], D = [Dw Dv], U_c = diag(Wc, Vc), Step 3; Delta_1, Delta_2, Delta_3 are a_x times
        H_A H_C', H_C H_C', H_A H_A' and the like of w and v, Step 1; Psi_1 = B U_c D' + Delta_1, (72),
        Psi_2 = D U_c D' + Delta_2, (73); Phi is the factor of x_pred, Step 4; rho the spectral radius of Phi - K C.
        In the code M = [A; C], U = [B; D] U_c [B; D]', J = U + [Delta_3 Delta_1; Delta_1' Delta_2].
Source  souto2011, Table 2, (46)-(49), (51), (59), (75)-(80), (85)-(87).
Assumed `equations`: Step 5 of Table 2 is printed with Delta_1, but the P that belongs to the printed K has Psi_1.
        `rule`: (76) bounds a_x by P, but Lemma 1 needs (47), a bound by X >= P.  With `rule: error` (as printed) P is
        not guaranteed after (47) fails; a remark reports this.  With `rule: state` a_x follows from X.
        `eps`, `gamma`: (76) and (47) need an excess over the largest eigenvalue.  `eps` is the paper's; `gamma` is a
        multiple of that eigenvalue and independent of units.
        Phi is that of Step 4, not of (70), which differs if P22c is singular (K C at k = 0): the bound is the same, the
        mean error is not.  `tuned` minimises the trace of the next P, not of the last one.  With `rule: state`, X
        determines every later a_x; therefore a_w and a_v may not increase the trace of the next X and of G X G' over
        those of eps or gamma.  With `rule: error` a smaller P gives a smaller a_x, and an error exceeds P sooner
        (section 5, eps = 0.1, constant F = 1: from k = 10 instead of 16).
Limit   Without uncertainty (all H = 0) the Kalman predictor.
Missing A run with gaps has its own bounds from then on: Table 2 for the outputs that are there.
Digits  `equations: printed` forms P at every step: its relative errors are 6e-9 at P(0) = 1e8 R and 1e-3 at 1e14 R
        (measured).
Cost    As every gain schedule; `tuned` solves for a_w, a_v and K alternately at every step.
Fails   Design error: w and v are correlated; eps is 0 where an excess is needed; `rule: state` and a constant system
        that is not quadratically stable; a bound overflows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.bridging import Gains, RunByRun
from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, schedule_of
from rmpc_bench.models.uncertain_linear import DesignSystem, design_systems
from rmpc_bench.numerics.divergence import LARGEST
from rmpc_bench.numerics.norm_bound import Excess, NoiseChannel, NoisePair
from rmpc_bench.numerics.robust_step import Channel, ParameterRules, RobustBounds, RobustStep, is_covariance
from rmpc_bench.numerics.square_root import covariance_of, root_of
from rmpc_bench.types import Array, DesignError, Model, NonNegative, Positive

EQUATION = r"""\hat x_{k+1|k} = \Phi_k \hat x_{k|k-1} + B u_k + K_k (y_k - C \hat x_{k|k-1}), \quad
\mathrm{cov}(\hat x_{k|k-1} - x_k) \le P_k"""


@dataclass(frozen=True)
class Margins:
    """Separate excess of a_x, a_w and a_v.

    Parameters
    ----------
    x, w, v : excess over the largest singular value, (85)-(87)
    """

    x: NonNegative
    w: NonNegative
    v: NonNegative


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    rule: Literal["error", "state"] = "error",
    eps: NonNegative | Margins | None = None,
    gamma: Positive | None = None,
    tuned: bool = False,
    design_scale: Positive = 1.0,
    equations: Literal["corrected", "printed"] = "corrected",
    literal: bool = False,
) -> GainScheduleFilter:
    """Enhanced robust predictor; equal to the Kalman predictor if the model has no uncertainty.

    Parameters
    ----------
    model : uncertain model
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    rule : `error` computes a_x from G P G' as printed, (76); `state` from the bound X of the state, (47), which
        guarantees the bound P
    eps : excess of a_x, a_w, a_v over the largest singular value, (85)-(87)
    gamma : excess as a multiple of the largest singular value; 1 if neither eps nor gamma is given
    tuned : whether to minimise the trace of the next P over a_w and a_v
    design_scale : factor of all uncertainty in this design
    equations : `printed` omits B U D' in the cross term of P (Step 5 as printed)
    literal : whether to evaluate Table 2 a second time, line by line, for the series `literal`: 1 while the result is a
        covariance matrix

    Raises
    ------
    DesignError
        If both eps and gamma are given, eps is 0 where an excess is needed, w and v are correlated, the system is
        not quadratically stable (`rule: state`), or a bound overflows.
    """
    x, w, v = _excesses(eps, gamma)
    rules = ParameterRules(x, w, v, rule == "state", tuned, equations == "printed")
    systems = design_systems(model, n_steps, design_scale)
    if any(now.S.any() for now in systems):
        raise DesignError("this predictor needs uncorrelated w and v; model their common part by Bw and Dw")
    if rules.state:
        _require_quadratic_stability(systems, design_scale)
    steps, P, X = _recursion(systems, P0, rules)
    extra = {name: np.array([step.a[i] for step in steps]) for i, name in enumerate(("a_x", "a_w", "a_v"))}
    if rules.state:
        extra["X"] = np.array(X)
    if literal:
        extra["literal"] = is_covariance(P0, [_channels(now, P0, rules) for now in systems])
    nominal, K, Phi = [now.nominal for now in systems], [step.K for step in steps], [step.Phi for step in steps]
    remarks = _remarks(steps, X, rules, design_scale)
    # X below 0 says that there is no bound of the state.
    kept = np.array([[root_of(each), X[k] if k < len(X) else -np.ones_like(P0)] for k, each in enumerate(P)])
    recursion = RunByRun(partial(_of_one_run, systems, rules))
    others: dict[str, Any] = {"extra": extra, "remarks": remarks, "uncertainty_scale": design_scale, "P_is": "bound"}
    return schedule_of(nominal, x0, K, P, F=Phi, root=kept, recursion=recursion, **others)


def _of_one_run(systems: Sequence[DesignSystem], rules: ParameterRules, k: int, kept: Array, there: Array) -> Gains:
    """Return the gains of a run in which measurements are missing: those of the system with the other outputs."""
    now, (root, X) = systems[k], kept
    fewer = {name: getattr(now.m, name)[there] for name in ("C", "Dw", "Dv", "H_C", "H_Dw", "H_Dv")}
    robust_step = _robust_step(now._replace(m=now.m._replace(**fewer)), rules)
    step = robust_step.step(root, None if X[0, 0] < 0.0 else X, robust_step.first_noises())
    X_next = -np.ones_like(X) if step.X_next is None else step.X_next
    return Gains(step.K, step.K, np.array([step.root_next, X_next]), covariance_of(root), F=step.Phi)


def _excesses(eps: float | Margins | None, gamma: float | None) -> tuple[Excess, Excess, Excess]:
    if eps is not None and gamma is not None:
        raise DesignError("give either eps or gamma", "gamma")
    if isinstance(eps, Margins):
        return Excess(eps=eps.x), Excess(eps=eps.w), Excess(eps=eps.v)
    one = Excess(gamma=1.0 if gamma is None else gamma) if eps is None else Excess(eps=eps)
    return one, one, one


def _recursion(
    systems: Sequence[DesignSystem], P0: Array, rules: ParameterRules
) -> tuple[list[RobustBounds], list[Array], list[Array]]:
    """Run the recursion of Table 2; X ends when (47) fails."""
    steps: list[RobustBounds] = []
    tracked = rules.state or any(_has_state_uncertainty(now) for now in systems)
    roots, X = [root_of(P0)], [P0] if tracked else []
    last, robust_step, noises = None, None, None
    for k, now in enumerate(systems):
        try:
            if robust_step is None or noises is None or now is not last:
                last, robust_step = now, _robust_step(now, rules)
                noises = robust_step.first_noises()
            step = robust_step.step(roots[k], X[k] if len(X) > k else None, noises)
        except ZeroDivisionError:
            raise DesignError(f"must be > 0: the uncertainty has an effect at k = {k}", "eps") from None
        steps.append(step)
        noises = step.noises
        roots.append(step.root_next)
        if step.X_next is not None:
            X.append(step.X_next)
        _refuse_overflow(k + 1, step.P_next, "the error")
        if rules.state:
            _refuse_overflow(k + 1, X[k + 1], "the state")
    return steps, list(covariance_of(np.array(roots[:-1]))), X[: len(systems)]


def _robust_step(now: DesignSystem, rules: ParameterRules) -> RobustStep:
    m = now.m
    noises = NoisePair(
        NoiseChannel(np.vstack([m.Bw, m.Dw]), np.vstack([m.H_Bw, m.H_Dw]), m.G_w, now.W),
        NoiseChannel(np.vstack([m.Bv, m.Dv]), np.vstack([m.H_Bv, m.H_Dv]), m.G_v, now.V),
    )
    return RobustStep(m.A, m.C, np.vstack([m.H_A, m.H_C]), m.G_x, noises, rules)


def _channels(now: DesignSystem, P0: Array, rules: ParameterRules) -> tuple[Channel, Channel, Channel]:
    m = now.m
    return (
        Channel(m.A, m.C, m.H_A, m.H_C, m.G_x, P0, rules.x),
        Channel(m.Bw, m.Dw, m.H_Bw, m.H_Dw, m.G_w, now.W, rules.w),
        Channel(m.Bv, m.Dv, m.H_Bv, m.H_Dv, m.G_v, now.V, rules.v),
    )


def _refuse_overflow(k: int, bound: Array, what: str) -> None:
    # Negated, so that NaN counts as an overflow.
    if not bound.trace() < LARGEST:
        raise DesignError(
            f"the bound of the covariance of {what} grows beyond {LARGEST:g} at k = {k}: choose another excess "
            "(gamma, eps), a smaller design_scale or fewer steps"
        )


def _remarks(steps: Sequence[RobustBounds], X: Sequence[Array], rules: ParameterRules, scale: float) -> tuple[str, ...]:
    """Report restrictions of the guarantee that P is a bound."""
    found = []
    scaled = "" if scale == 1.0 else f" for {scale:g} times the uncertainty of the model"
    if 0 < len(X) < len(steps):
        k = len(X) - 1
        found.append(
            f"the bound P is not guaranteed{scaled} after k = {k}, where (47) fails; `rule: state` avoids this"
        )
    elif scaled:
        found.append(f"the bound P is guaranteed only{scaled}")
    if rules.printed and any(step.noises.U[: len(step.K), len(step.K) :].any() for step in steps):
        found.append("Step 5 as printed omits B U D': P is not the bound that belongs to K")
    return tuple(found)


def _has_state_uncertainty(now: DesignSystem) -> bool:
    m = now.m
    return bool((m.H_A.any() or m.H_C.any()) and m.G_x.any())


def _require_quadratic_stability(systems: Sequence[DesignSystem], scale: float) -> None:
    """Reject a constant system that is not quadratically stable."""
    # If B U_c B' > 0, quadratic stability is necessary for a sequence of a_x with bounded X: the mean of X over k is
    # then a Lyapunov matrix for every F. It is not sufficient for a given eps or gamma.
    from rmpc_bench.numerics.stability import hinf_peak, spectral_radius

    m = systems[0].m
    if not _has_state_uncertainty(systems[0]) or any(now is not systems[0] for now in systems):
        return
    says = "the system is not quadratically stable: the"
    or_else = "and must be < 1, otherwise no bound of this kind holds for all k"
    radius = spectral_radius(m.A)
    if radius >= 1.0:
        raise DesignError(f"{says} spectral radius of A is {radius:.6g}, {or_else}", "rule")
    norm = hinf_peak(m.A, m.H_A, m.G_x).norm
    if norm >= 1.0:
        raise DesignError(
            f"{says} H-infinity norm of G_x (zI - A)^-1 H_A times design_scale is {norm:.6g}, {or_else}; "
            f"design_scale must be below {scale / norm:.6g}",
            "design_scale",
        )
