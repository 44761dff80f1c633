"""H-infinity filter: it bounds the energy gain from noises and initial error to the weighted estimation error.

Model   x(k+1) = A x(k) + B u(k) + w(k),  y(k) = C x(k) + v(k), with any w and v.  For theta = 1 / gamma^2 and
        W = weight' weight,
        sum |x - x_hat|^2_W <= gamma^2 (|x(0) - x0|^2_{P0^-1} + sum |w|^2_{Q_w^-1} + sum |v|^2_{R_v^-1}).
        P_pred(k+1) = A (P_pred^-1 - theta W + C' R_v^-1 C)^-1 A' + Q_w is no covariance of an error: the filter reports
        no P.
Forms   `filter` (a posteriori): L = P_pred C' (C P_pred C' + R_v)^-1 = P C' R_v^-1, where
        P = (P_pred^-1 + C' R_v^-1 C)^-1 must satisfy P^-1 > theta W at every k.
        `predictor` (a priori): K = A V C' (C V C' + R_v)^-1 with V = (P_pred^-1 - theta W)^-1; P_pred^-1 > theta W at
        every k.  Simon prints the weaker one of the other form.  At k = 0 without y(0) the condition of both forms is
        P0^-1 > theta W.
Source  Simon, Optimal State Estimation (2006), chapter 11; Hassibi, Sayed, Kailath (1999); Shaked and Theodor (1992).
Limit   theta = 0 gives the Kalman filter.  The predictor with W = I is the predictor of `risk-sensitive`.
Missing A run with gaps has its own P_pred from then on, with the same theta.  Where the condition does not hold for the
        others, this sample has no weight in the bound.
Cost    As every gain schedule.  `fraction` repeats the recursion about 30 times to find theta_max by bisection.
Fails   Design error if a condition is violated; it names the first k and theta_max, the least upper bound of theta for
        k = 0..N.  Design error if R_v is singular.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np
from annotated_types import Gt, Lt
from jaxtyping import Float

from rmpc_bench.estimators.bridging import Gains, Outputs, RunByRun
from rmpc_bench.estimators.gain_schedule import (
    Form,
    GainScheduleFilter,
    refuse_overflow,
    schedule_of,
    uncorrelated,
)
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import as_matrix, has_root, nearly_equal
from rmpc_bench.numerics.riccati import filter_step, predicted_root
from rmpc_bench.numerics.square_root import covariance_of, root_of
from rmpc_bench.types import Array, DesignError, Matrix, Model, NonNegative, Positive

EQUATION = r"""P_{k+1|k} = A (P_{k|k-1}^{-1} - \theta W + C^\top R_v^{-1} C)^{-1} A^\top + Q_w, \quad
\theta = 1 / \gamma^2"""
Fraction: TypeAlias = Annotated[float, Gt(0), Lt(1)]
_DIGITS = 1e-8
"""Relative accuracy of theta_max."""
_STEADY = 1e-14
"""Change of P_pred per step, relative to the standard deviations, that counts as rounding."""


class Period(NamedTuple):
    """One period of the recursion."""

    L: Float[Array, "nx ny"]
    K: Float[Array, "nx ny"]
    margin: float
    """1 - theta lambda_max(weight P weight') for the P of the condition; positive where the condition holds."""
    largest: float
    """lambda_max(weight P weight')."""
    root_next: Float[Array, "nx nx"]
    """Root of P_pred(k+1)."""


@dataclass(frozen=True, eq=False)
class Recursion:
    """The recursion of all k for any theta; `weight` is a root of W."""

    models: Sequence[LinearModel]
    P0: Float[Array, "nx nx"]
    weight: Float[Array, "nx nx"]
    form: Form
    use_y0: bool

    def run(self, theta: float) -> tuple[list[Period], list[Array]]:
        """Return the periods up to the first one that violates the condition, and the roots of P_pred of all."""
        periods, roots = list[Period](), [root_of(self.P0)]
        for k, now in enumerate(self.models):
            # The recursion of a constant model stays where it has become steady.
            if self._constant and k > 1 and nearly_equal(covariance_of(roots[-2]), covariance_of(roots[-1]), _STEADY):
                left = len(self.models) - k
                periods, roots = periods + periods[-1:] * left, roots + roots[-1:] * left
                break
            period = self._period(now, roots[-1], theta, measured=k > 0 or self.use_y0)
            periods.append(period)
            if not period.margin > 0.0:
                break
            roots.append(period.root_next)
        return periods, roots[: len(periods)]

    def of_one_run(self, theta: float, k: int, root: Array, there: Array) -> Gains:
        """Return the gains of a run in which measurements are missing."""
        outputs = Outputs.of(self.models[k], there)
        period = self._period(outputs, root, theta, measured=k > 0 or self.use_y0)
        if not period.margin > 0.0:
            period = self._period(outputs, root, 0.0, measured=k > 0 or self.use_y0)
        return Gains(period.L, period.K, period.root_next, None)

    def _period(self, now: LinearModel | Outputs, root: Array, theta: float, *, measured: bool) -> Period:
        kalman = filter_step(now.A, now.C, now.Q_w, now.R_v, root, measured=measured)
        chosen = root if self.form == "predictor" else kalman.root
        largest = float(np.linalg.norm(self.weight.dot(chosen), 2) ** 2)
        margin = 1.0 - theta * largest
        if not margin > 0.0:
            return Period(kalman.L, kalman.K, margin, largest, root)
        inflated = inflated_by_weight(chosen, self.weight, theta)
        if self.form == "predictor":
            step = filter_step(now.A, now.C, now.Q_w, now.R_v, inflated, measured=measured)
            return Period(np.zeros_like(step.L), step.K, margin, largest, step.root_next)
        return Period(kalman.L, kalman.K, margin, largest, predicted_root(now.A, now.Q_w, inflated))

    def theta_max(self) -> float:
        """Return the largest theta, to eight digits, for which all conditions hold; infinite if there is no bound.

        Designs with other fractions of it share it, as it takes most of the time of a design.
        """
        return _bound(self._content, self) if self._constant else self._theta_max()

    @cached_property
    def _constant(self) -> bool:
        return all(each is self.models[0] for each in self.models)

    @property
    def _content(self) -> tuple[object, ...]:
        """What determines the recursion of a constant model."""
        now = self.models[0]
        arrays = (now.A, now.C, now.Q_w, now.R_v, self.P0, self.weight)
        return (*((each.shape, each.tobytes()) for each in arrays), self.form, self.use_y0, len(self.models))

    def _theta_max(self) -> float:
        largest = max(each.largest for each in self.run(0.0)[0])
        if largest <= 0.0:
            return np.inf
        # P_pred increases with theta, so that the bound of theta = 0 is an upper one.
        low, high = 0.0, 1.0 / largest
        while high - low > _DIGITS * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.run(middle)[0][-1].margin > 0.0 else (low, middle)
        return low


_bounds: dict[tuple[object, ...], float] = {}
_MOST_BOUNDS = 256


def _bound(content: tuple[object, ...], recursion: Recursion) -> float:
    """Return theta_max of a recursion, computed once for equal ones."""
    if content not in _bounds:
        while len(_bounds) >= _MOST_BOUNDS:
            _bounds.pop(next(iter(_bounds)))
        _bounds[content] = recursion._theta_max()
    return _bounds[content]


def inflated_by_weight(F: Float[Array, "nx r"], weight: Float[Array, "nx nx"], theta: float) -> Float[Array, "nx r"]:
    """Return the root of (P^-1 - theta weight' weight)^-1 = F (I - theta (weight F)'(weight F))^-1 F' from one of P."""
    _, sizes, W = np.linalg.svd(weight.dot(F))
    inflated: Array = F.dot((W.T / np.sqrt(1.0 - theta * sizes * sizes)).dot(W))
    return inflated


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    theta: NonNegative | None = None,
    gamma: Positive | None = None,
    fraction: Fraction | None = None,
    weight: Matrix = 1.0,
    form: Form = "filter",
    use_y0: bool = True,
) -> GainScheduleFilter:
    """H-infinity filter; give exactly one of theta, gamma and fraction.

    Parameters
    ----------
    model : design model
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) estimate of the initial state
    P0 : (nx, nx) inverse of the weight of its error
    theta : 1 / gamma^2, >= 0
    gamma : bound of the energy gain
    fraction : theta as a fraction of theta_max, the least upper bound for k = 0..N; independent of units
    weight : (nx, nx) matrix M of W = M' M
    form : `filter` uses y(k) for x_hat(k), `predictor` does not
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If not exactly one of theta, gamma and fraction is given, R_v is singular, or theta is not below theta_max.
    """
    models = uncorrelated(model, n_steps)
    for k, now in enumerate(models):
        if not (k and now is models[k - 1]) and not has_root(now.R_v):
            raise DesignError(f"R_v is singular at k = {k}: its inverse weighs the measurement noise")
    recursion = Recursion(models, P0, as_matrix(weight, model.nx, "weight"), form, use_y0)
    chosen, remarks = _theta(recursion, theta, gamma, fraction)
    periods, roots = recursion.run(chosen)
    if not periods[-1].margin > 0.0:
        raise _violated(recursion, chosen, len(periods) - 1, "gamma" if theta is None else "theta")
    P_pred = covariance_of(np.array(roots))
    refuse_overflow(P_pred)
    extra = {"P_pred": P_pred, "margin": np.array([each.margin for each in periods])}
    extra["theta"] = np.full(len(periods), chosen)
    K, L = [each.K for each in periods], [each.L for each in periods] if form == "filter" else None
    own = RunByRun(partial(recursion.of_one_run, chosen))
    return schedule_of(models, x0, K, None, L=L, extra=extra, remarks=remarks, root=np.array(roots), recursion=own)


def _theta(
    recursion: Recursion, theta: float | None, gamma: float | None, fraction: float | None
) -> tuple[float, tuple[str, ...]]:
    """Return theta, and a sentence about it where it is a fraction of theta_max."""
    if sum(each is not None for each in (theta, gamma, fraction)) != 1:
        raise DesignError("give exactly one of theta, gamma and fraction")
    if fraction is None:
        return (1.0 / gamma**2 if theta is None else theta), ()  # type: ignore[operator]
    bound = recursion.theta_max()
    if not np.isfinite(bound):
        raise DesignError("theta has no upper bound, because the weight or all P are zero; give theta", "fraction")
    chosen = fraction * bound
    return chosen, (f"theta = {chosen:.6g} ({fraction:g} of theta_max = {bound:.6g}), gamma = {chosen**-0.5:.6g}",)


def _violated(recursion: Recursion, theta: float, k: int, key: str) -> DesignError:
    """Return the error for a theta that is too large."""
    matrix = "P_pred^-1" if recursion.form == "predictor" or (k == 0 and not recursion.use_y0) else "P^-1"
    bound = recursion.theta_max()
    wanted = f"gamma > {bound**-0.5:.6g}" if key == "gamma" else "a smaller theta"
    text = f"{matrix} > theta W is violated at k = {k}: theta = {theta:.6g}, theta_max = {bound:.6g} for all k"
    return DesignError(f"{text}; choose {wanted} or fraction: 0.9", key)
