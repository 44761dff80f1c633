"""Enhanced robust predictor: a Riccati recursion for uncertainty of norm at most 1, with a guarantee by `rule: state`.

Model   x(k+1) = (A + H_A F_x G_x) x + B u + f0 + (Bw + H_Bw F_w G_w) w + (Bv + H_Bv F_v G_v) v,
        y(k) = (C + H_C F_x G_x) x + d0 + (Dw + H_Dw F_w G_w) w + (Dv + H_Dv F_v G_v) v, F' F <= I, w and v white and
        uncorrelated; x_pred+ = Phi x_pred + B u + f0 + K (y - C x_pred - d0).
        As long as (47) holds, with `rule: state` always, P bounds the covariance of x_pred - x given the sequence of
        all F, whatever it is; not the mean error, nor what the spread of that mean over random F adds.
Symbols a_x, a_w, a_v are 1/alpha_x, 1/alpha_w, 1/alpha_v; X = P11 bounds the covariance of x; Pc, Wc, Vc are P, W, V
        widened in Step 2; B = [Bw Bv], D = [Dw Dv], U_c = diag(Wc, Vc), Step 3; Delta_1, Delta_2, Delta_3 are a_x times
        H_A H_C', H_C H_C', H_A H_A' and the like of w and v, Step 1; Psi_1 = B U_c D' + Delta_1, (72),
        Psi_2 = D U_c D' + Delta_2, (73); Phi is the factor of x_pred, Step 4; rho the spectral radius of Phi - K C.
        In the code M = [A; C], U = [B; D] U_c [B; D]', J = U + [Delta_3 Delta_1; Delta_1' Delta_2].
Source  souto2011, Table 2, (46)-(49), (51), (59), (75)-(80), (85)-(87).
Chosen  Step 5 of Table 2 is printed with Delta_1 where the P of the printed K has Psi_1 (`equations`).  (76) bounds
        a_x by P, but Lemma 1 needs (47), a bound by X >= P: with `rule: error` (as printed) P is no guarantee once
        (47) fails, which a remark tells; `rule: state` takes a_x from X.  (76) and (47) need an excess over the
        largest eigenvalue: `eps` is the paper's, `gamma` a multiple of that eigenvalue and so free of units.
        Phi is that of Step 4, not of (70): where P22c is singular they differ (at k = 0, (70) gives K C), with the
        same bound and another mean error.
        `tuned` is myopic: it makes the trace of the next P least, not that of the last.  With `rule: state`, where X
        makes every later a_x, it only takes a_w and a_v with which the next X, its trace and what F_x sees of it, is no
        larger than with eps or gamma.  With `rule: error` a smaller P makes a smaller a_x, and where P is no guarantee
        it is exceeded sooner (section 5, eps = 0.1, all F = 1 for ever: from k = 10 on instead of 16).
Limit   without uncertainty (all H = 0) the Kalman predictor.
Cost    as every gain schedule; `tuned` solves for a_w, a_v and K in turns at every step.
Fails   design error where w and v are correlated, where eps is 0 but needed, where `rule: state` meets a system that
        does not vary and is not quadratically stable, or where a bound overflows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, predictor_schedule
from rmpc_bench.models.design_noise import DesignSystem, design_systems
from rmpc_bench.numerics.kl_ball import LARGEST
from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.numerics.noise_pair import FREE, NoisePair, Noises
from rmpc_bench.numerics.norm_bound import Excess, NoiseChannel, Widening, keep_a, spectrum, widen
from rmpc_bench.numerics.riccati import predictor_gain, predictor_step
from rmpc_bench.types import Array, DesignError, Model, NonNegative, Positive


@dataclass(frozen=True)
class Margins:
    """Excess of a_x, a_w and a_v, one by one.

    Parameters
    ----------
    x, w, v : added to the largest singular value, (85)-(87)
    """

    x: NonNegative
    w: NonNegative
    v: NonNegative


@dataclass(frozen=True)
class ParameterRules:
    """How the free parameters of Table 2 are chosen."""

    x: Excess
    w: Excess
    v: Excess
    state: bool
    tuned: bool
    printed: bool


class Step(NamedTuple):
    """One period of Table 2."""

    K: Float[Array, "nx ny"]
    Phi: Float[Array, "nx nx"]
    P_next: Float[Array, "nx nx"]
    X_next: Float[Array, "nx nx"] | None
    """None from where (47) fails."""
    a: tuple[float, float, float]
    """a_x, a_w, a_v; 0 where there is no such uncertainty."""
    noises: Noises


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
) -> GainScheduleFilter:
    """Enhanced robust predictor; a model without uncertainty makes it the Kalman predictor.

    Parameters
    ----------
    model : uncertain model
    n_steps : number of control periods N; gains are made for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) its covariance
    rule : `error` takes a_x from G P G' as printed, (76); `state` from the bound X of the state, (47), a guarantee
    eps : excess of a_x, a_w, a_v over the largest singular value, one number or `{x: .., w: .., v: ..}`, (85)-(87)
    gamma : the excess as a multiple of that value, 1 where neither is given
    tuned : choose a_w and a_v so that the trace of the next P (not the last) is least; with `rule: state` among those
        with which the next X is no larger than with eps or gamma
    design_scale : factor of all uncertainty in this design
    equations : `printed` leaves B U D' out of the cross term of P (Step 5 as printed)

    Raises
    ------
    DesignError
        If both eps and gamma are given, eps is 0 where it must not be, w and v are correlated, the system is
        not quadratically stable (`rule: state`), or a bound overflows.
    """
    x, w, v = _excesses(eps, gamma)
    choice = ParameterRules(x, w, v, rule == "state", tuned, equations == "printed")
    systems = design_systems(model, n_steps, design_scale)
    if any(now.S.any() for now in systems):
        raise DesignError("this predictor needs w and v without correlation; put what they share into Bw and Dw")
    if choice.state:
        _insist_on_a_bound(systems, design_scale)
    steps, P, X = _recursion(systems, P0, choice)
    extra = {name: np.array([step.a[i] for step in steps]) for i, name in enumerate(("a_x", "a_w", "a_v"))}
    if choice.state:
        extra["X"] = np.array(X)
    nominal, K, Phi = [now.nominal for now in systems], [step.K for step in steps], [step.Phi for step in steps]
    remarks = _remarks(steps, X, choice, design_scale)
    return predictor_schedule(nominal, x0, K, P, F=Phi, extra=extra, remarks=remarks)


def _excesses(eps: float | Margins | None, gamma: float | None) -> tuple[Excess, Excess, Excess]:
    if eps is not None and gamma is not None:
        raise DesignError("give either eps or gamma", "gamma")
    if isinstance(eps, Margins):
        return Excess(eps=eps.x), Excess(eps=eps.w), Excess(eps=eps.v)
    one = Excess(gamma=1.0 if gamma is None else gamma) if eps is None else Excess(eps=eps)
    return one, one, one


def _recursion(
    systems: Sequence[DesignSystem], P0: Array, choice: ParameterRules
) -> tuple[list[Step], list[Array], list[Array]]:
    """Run Table 2; X ends where (47) fails."""
    steps: list[Step] = []
    tracked = choice.state or any(_sees_the_state(now) for now in systems)
    P, X = [P0], [P0] if tracked else []
    recursion, noises = None, None
    for k, now in enumerate(systems):
        try:
            if recursion is None or noises is None or now is not recursion.system:
                recursion = Recursion(now, choice)
                noises = recursion.first_noises()
            step = recursion.step(P[k], X[k] if len(X) > k else None, noises)
        except ZeroDivisionError:
            raise DesignError(f"must be > 0: the uncertainty is seen at k = {k}", "eps") from None
        steps.append(step)
        noises = step.noises
        P.append(step.P_next)
        if step.X_next is not None:
            X.append(step.X_next)
        _refuse_overflow(k + 1, step.P_next, "the error")
        if choice.state:
            _refuse_overflow(k + 1, X[k + 1], "the state")
    return steps, P[:-1], X[: len(systems)]


def _refuse_overflow(k: int, bound: Array, what: str) -> None:
    if not bound.trace() < LARGEST:  # true for nan
        raise DesignError(
            f"the bound of the covariance of {what} grows beyond {LARGEST:g} at k = {k}: choose another excess "
            "(gamma, eps), a smaller design_scale or fewer steps"
        )


class Recursion:
    """Table 2 at one k, with everything that depends on the system alone computed once."""

    def __init__(self, system: DesignSystem, choice: ParameterRules) -> None:
        self.system, self.choice = system, choice
        m = system.m
        self.A, self.C, self.G = m.A, m.C, m.G_x
        self.M: Array = np.vstack([m.A, m.C])
        H = np.vstack([m.H_A, m.H_C])
        self.HH: Array = H.dot(H.T)
        self.uncertain = _sees_the_state(system)
        self.noises = NoisePair(
            NoiseChannel(np.vstack([m.Bw, m.Dw]), np.vstack([m.H_Bw, m.H_Dw]), m.G_w, system.W),
            NoiseChannel(np.vstack([m.Bv, m.Dv]), np.vstack([m.H_Bv, m.H_Dv]), m.G_v, system.V),
        )
        protects_X = choice.tuned and choice.state
        self.within = self.noises.no_worse(m.A, m.G_x, choice.w, choice.v) if protects_X else (FREE, FREE)

    def first_noises(self) -> Noises:
        """Bound the noises with the chosen excesses, (86), (87); where they are tuned, with a first guess."""
        pair, choice = self.noises, self.choice
        if choice.tuned:
            return pair.at(*(float(channel.lam[-1]) for channel in pair))
        return pair.at(pair.w.excess(choice.w), pair.v.excess(choice.v))

    def step(self, P: Array, X: Array | None, noises: Noises) -> Step:
        """Go from the bounds at k to those at k+1."""
        Pc, Xc, Phi, a_x, L = P, X, self.A, 0.0, None
        if self.uncertain:
            of_P, of_X = self._widenings(P, X)
            PG, a_x = P.dot(self.G.T), of_P.a  # Step 1
            seen = PG.dot(of_P.inverse)
            Pc, L = symmetrise(P + seen.dot(PG.T)), seen.dot(self.G)  # Step 2, (75)
            Xc = None
            if X is not None and of_X is not None:
                XG = X.dot(self.G.T)
                Xc = X + XG.dot(of_X.inverse).dot(XG.T)  # (59)
        K, P_next, J, noises = self._gain(Pc, a_x, noises)
        if L is not None:
            Phi = Phi + (self.A - K.dot(self.C)).dot(L)  # Step 4, (79), (80)
        nx = len(P)
        X_next = None if Xc is None else symmetrise(self.A.dot(Xc).dot(self.A.T) + J[:nx, :nx])  # (51)
        if self.choice.printed:
            P_next = self._as_printed(Pc, J, noises.U)
        a = a_x, self.noises.w.a(noises.t_w), self.noises.v.a(noises.t_v)
        return Step(K, Phi, P_next, X_next, a, noises)

    def _widenings(self, P: Array, X: Array | None) -> tuple[Widening, Widening | None]:
        """Choose a_x, and invert a_x I - G P G' and a_x I - G X G'; None where (47) fails or has failed."""
        GPG = symmetrise(self.G.dot(P).dot(self.G.T))
        if X is None:
            return widen(GPG, self.choice.x), None  # (76), (85)
        GXG = symmetrise(self.G.dot(X).dot(self.G.T))
        if not self.choice.state:
            of_P = widen(GPG, self.choice.x)
            return of_P, keep_a(of_P, GPG - GXG)
        of_X = widen(GXG, self.choice.x)  # (47)
        lam, U = spectrum(GXG - GPG)  # not negative, as X >= P
        return keep_a(of_X, (U * lam).dot(U.T)) or of_X, of_X

    def _gain(self, Pc: Array, a_x: float, noises: Noises) -> tuple[Array, Array, Array, Noises]:
        """Return K, P_next, their J and the noises; if tuned, a_w and a_v are chosen in turns with K."""
        own = a_x * self.HH  # Step 1
        if self.choice.tuned:
            (K, P_next), noises = self.noises.tuned_step(self.M, own, Pc, noises, self.within)
            return K, P_next, noises.J + own, noises
        J = noises.J + own
        K, P_next = predictor_step(self.M, J, Pc)  # Step 4, and Step 5 in Joseph form
        return K, P_next, J, noises

    def _as_printed(self, Pc: Array, J: Array, U: Array) -> Array:
        """Step 5 as printed: Delta_1 in place of Psi_1."""
        nx = len(Pc)
        Y = self.M.dot(Pc).dot(self.M.T) + J
        N = Y[:nx, nx:] - U[:nx, nx:]
        return symmetrise(Y[:nx, :nx] - predictor_gain(N, Y[nx:, nx:]).dot(N.T))  # Step 5


def _remarks(steps: Sequence[Step], X: Sequence[Array], choice: ParameterRules, scale: float) -> tuple[str, ...]:
    """Say whether P is the bound it is meant to be."""
    found = []
    scaled = "" if scale == 1.0 else f" for {scale:g} times the uncertainty of the model"
    if 0 < len(X) < len(steps):
        k = len(X) - 1
        found.append(f"the bound is no guarantee{scaled} beyond k = {k}, where (47) fails (rule: state keeps it)")
    elif scaled:
        found.append(f"the bound is a guarantee{scaled} only")
    if choice.printed and any(step.noises.U[: len(step.K), len(step.K) :].any() for step in steps):
        found.append("Step 5 as printed leaves out B U D': P is not the bound that belongs to K")
    return tuple(found)


def _sees_the_state(now: DesignSystem) -> bool:
    m = now.m
    return bool((m.H_A.any() or m.H_C.any()) and m.G_x.any())


def _insist_on_a_bound(systems: Sequence[DesignSystem], scale: float) -> None:
    """Refuse a system, if it does not vary, that is not quadratically stable.

    Where B U_c B' > 0, X stays bounded for all k with some sequence of a_x only if the system is: the mean of X over k
    then is a Lyapunov matrix for every F.  Whether it stays bounded with a given eps or gamma is another question.
    """
    from rmpc_bench.numerics.stability import hinf_norm, spectral_radius

    m = systems[0].m
    if not _sees_the_state(systems[0]) or any(now is not systems[0] for now in systems):
        return
    says = "the system is not quadratically stable: the"
    or_else = "and must be < 1, or no bound of this kind holds for all k"
    radius = spectral_radius(m.A)
    if radius >= 1.0:
        raise DesignError(f"{says} spectral radius of A is {radius:.6g}, {or_else}", "rule")
    norm = hinf_norm(m.A, m.H_A, m.G_x)
    if norm >= 1.0:
        raise DesignError(
            f"{says} H-infinity norm of G_x (zI - A)^-1 H_A times design_scale is {norm:.6g}, {or_else}; "
            f"design_scale must be below {scale / norm:.6g}",
            "design_scale",
        )
