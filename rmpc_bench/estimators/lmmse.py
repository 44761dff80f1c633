"""Linear minimum mean-square error estimator for an uncertain system with white uncertainty of known moments.

Model   The system of uncertain_system.py.  Every F is diagonal, with white independent entries of common mean and
        variance.  P is the exact covariance of x_hat - x over noises and uncertainty for u = 0; X is the second moment
        E x x'.
Forms   `predictor`: x_hat(k) uses y(0..k-1).  `filter`: x_hat(k) uses y(k) as well, with the gain
        L = P_pred C' (C P_pred C' + R)^-1, R the covariance of y(k) given x(k) and x_hat of the predictor.  Both have
        the same predictions: K = (A P_pred C' + S)(C P_pred C' + R)^-1, where S is the covariance of the noises of
        x(k+1) and y(k) that a common F causes.
Source  Nahi, IEEE Trans. Information Theory 15 (1969); De Koning, Automatica 20 (1984); derived for this system from
        the moments of [x(k+1); y(k)].
Limit   Without uncertainty, or with variance 0, the Kalman filter or predictor of the mean system.
Missing A run with gaps has its own gains and P from then on.
Cost    As every gain schedule.
Fails   Design error if E x x' overflows: the system is not stable in the mean square.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.bridging import Gains, RunByRun, with_outputs
from rmpc_bench.estimators.gain_schedule import Form, GainScheduleFilter, schedule_of
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.uncertain_linear import DesignSystem, design_systems
from rmpc_bench.numerics.divergence import LARGEST
from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.numerics.riccati import predictor_step
from rmpc_bench.numerics.square_root import Conditional, corrected, covariance_of, root_of
from rmpc_bench.types import Array, DesignError, Model, NonNegative

EQUATION = r"""\hat x_{k+1|k} = \bar A \hat x_{k|k-1} + B u_k + K_k e_k, \quad
K_k = \mathrm{cov}(x_{k+1}, e_k) \mathrm{cov}(e_k)^{-1}"""


@dataclass(frozen=True)
class EntryLaw:
    """Distribution of the diagonal entries of the F, `{low: -1, high: 1}` or `{mean: 0, variance: 1/3}`.

    Parameters
    ----------
    low, high : bounds of a uniform distribution
    mean, variance : moments of any other distribution
    """

    low: float | None = None
    high: float | None = None
    mean: float | None = None
    variance: NonNegative | None = None

    def __post_init__(self) -> None:
        """Check that exactly one of the two forms is given."""
        uniform, moments = (self.low, self.high), (self.mean, self.variance)
        if None in (moments if uniform == (None, None) else uniform) or (None, None) not in (uniform, moments):
            raise ValueError("give either low and high or mean and variance")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError(f"low ({self.low:g}) must not exceed high ({self.high:g})")

    @property
    def moments(self) -> tuple[float, float]:
        """Mean and variance."""
        if self.low is not None and self.high is not None:
            return 0.5 * (self.low + self.high), (self.high - self.low) ** 2 / 12.0
        return self.mean or 0.0, self.variance or 0.0


class Source(NamedTuple):
    """The zero-mean uncertain part of [x(k+1); y] due to a signal q: H (F - E F) G q."""

    H: Float[Array, "nz r"]
    G: Float[Array, "s n"]

    def covariance(self, second: Float[Array, "n n"], variance: float) -> Float[Array, "nz nz"]:
        """Return H diag(variance (G E[q q'] G')_ii) H' for the second moment E[q q']."""
        r = min(self.H.shape[1], len(self.G))
        H, G = self.H[:, :r], self.G[:r]
        product: Array = (H * (variance * (G.dot(second) * G).sum(axis=1))).dot(H.T)
        return product


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    law: EntryLaw | None = None,
    form: Form = "predictor",
) -> GainScheduleFilter:
    """Linear minimum mean-square error estimator under white uncertainty.

    Parameters
    ----------
    model : uncertain model
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    law : law of the entries of F: uniform `{low: -1, high: 1}` (default), or `{mean: 0, variance: 1/3}`
    form : `filter` uses y(k) for x_hat(k), `predictor` does not

    Raises
    ------
    DesignError
        If E x x' overflows.
    """
    mean, variance = (law or EntryLaw(low=-1.0, high=1.0)).moments
    systems = design_systems(model, n_steps)
    mean_system = None
    models, joint, roots, K, X, corrections = [], [], [root_of(P0)], [], [], list[Conditional]()
    mu, cov = x0, P0
    for k, now in enumerate(systems):
        if mean_system is None or now is not mean_system.system:
            mean_system = MeanSystem(now, mean, variance)
        second = cov + np.outer(mu, mu)
        J = mean_system.noise(second)
        step = predictor_step(mean_system.M, J, roots[-1])
        nx = len(mu)
        if form == "filter":
            # The noise of y(k) contains the deviation of F(k) from its mean times x(k).  It is uncorrelated with the
            # error x_pred(k) - x(k), because F(k) is independent of both and its deviation has mean 0.
            corrections.append(corrected(mean_system.M[nx:], root_of(J[nx:, nx:]), roots[-1]))
        models.append(mean_system.model)
        joint.append((mean_system.M, J))
        X.append(second)
        K.append(step.K)
        roots.append(step.root_next)
        mu = mean_system.model.A.dot(mu) + mean_system.model.f0
        cov = symmetrise(mean_system.model.A.dot(cov).dot(mean_system.model.A.T) + J[:nx, :nx])
        # Negated, so that NaN counts as an overflow.
        if not cov.trace() + mu.dot(mu) < LARGEST:
            raise DesignError(
                f"the second moment of the state grows beyond {LARGEST:g} at k = {k + 1}: the system is not stable in "
                "the mean square; choose a smaller variance or fewer steps"
            )
    P = covariance_of(np.array(roots[:-1]))
    extra, L = {"X": np.array(X)}, None
    if form == "filter":
        L, extra["P_pred"] = [each.gain for each in corrections], P
        P = covariance_of(np.array([each.root for each in corrections]))
    own = RunByRun(partial(_of_one_run, joint, form == "filter"))
    return schedule_of(models, x0, K, P, L=L, extra=extra, root=np.array(roots[:-1]), recursion=own)


class MeanSystem:
    """The mean system at one k, and the covariance of the deviation from it."""

    def __init__(self, system: DesignSystem, mean: float, variance: float) -> None:
        self.system, self.variance = system, variance
        m, old = system.m, system.nominal
        nx = len(m.A)
        self.x = Source(np.vstack([m.H_A, m.H_C]), m.G_x)
        w, v = Source(np.vstack([m.H_Bw, m.H_Dw]), m.G_w), Source(np.vstack([m.H_Bv, m.H_Dv]), m.G_v)
        self.M: Array = np.vstack([m.A, m.C]) + _mean_part(self.x, mean)
        extra_w, extra_v = _mean_part(w, mean), _mean_part(v, mean)
        enters = np.hstack([np.vstack([m.Bw, m.Dw]) + extra_w, np.vstack([m.Bv, m.Dv]) + extra_v])
        joint = np.block([[system.W, system.S], [system.S.T, system.V]])
        W = system.W + np.outer(system.wbar, system.wbar)
        V = system.V + np.outer(system.vbar, system.vbar)
        uncertain = w.covariance(W, variance) + v.covariance(V, variance)
        self.J: Array = symmetrise(enters.dot(joint).dot(enters.T) + uncertain)
        shift = extra_w.dot(system.wbar) + extra_v.dot(system.vbar)
        Q, R, S = self.J[:nx, :nx], self.J[nx:, nx:], self.J[:nx, nx:]
        f0, d0 = old.f0 + shift[:nx], old.d0 + shift[nx:]
        self.model = LinearModel(self.M[:nx], m.B, self.M[nx:], Q, R, S_wv=S, f0=f0, d0=d0)

    def noise(self, second: Float[Array, "nx nx"]) -> Float[Array, "nz nz"]:
        """Return the covariance of the total noise in [x(k+1); y] for the second moment E x x'."""
        return self.J + self.x.covariance(second, self.variance)


def _mean_part(source: Source, mean: float) -> Float[Array, "nz n"]:
    """Return H E[F] G."""
    r = min(source.H.shape[1], len(source.G))
    product: Array = mean * source.H[:, :r].dot(source.G[:r])
    return product


def _of_one_run(joint: list[tuple[Array, Array]], corrects: bool, k: int, root: Array, there: Array) -> Gains:
    """Return the gains of a run in which measurements are missing; E x x' does not depend on them."""
    nx, (M, J) = len(root), with_outputs(*joint[k], there)
    step = predictor_step(M, J, root)
    if not corrects:
        return Gains(step.K, step.K, step.root_next, covariance_of(root))
    now = corrected(M[nx:], root_of(J[nx:, nx:]), root)
    return Gains(now.gain, step.K, step.root_next, covariance_of(now.root))
