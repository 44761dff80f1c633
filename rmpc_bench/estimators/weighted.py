"""Kalman filter whose measured outputs get weights that depend on the data, shared by the filters for outliers.

Model   x(k+1) = A x(k) + B u(k) + f0 + w(k),  y(k) = C x(k) + d0 + v(k),  w ~ N(0, Q_w), white; v(k) has the scale
        matrix R_v and a law with outliers.  A correction is that of a Kalman filter with R_v over the weights.
        x_hat and P are computed run by run, as the weights differ.
Missing An output that is NaN has no effect on the correction; its weight is reported as 0.
Cost    numerics/output_weights.py, compiled: 0.8 us per run and step of `student-kalman`
        and `huber-kalman` with two states and one output, in blocks of 50 runs (`make perf`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import over_time, uncorrelated
from rmpc_bench.models.noise_sets import NoiseSets, stochastic_sets
from rmpc_bench.numerics.linalg import at_sample, check_signal
from rmpc_bench.numerics.output_weights import (
    OwnState,
    WeightLaw,
    corrected,
    measured,
    predicted,
    whitening,
    whitening_of_runs,
)
from rmpc_bench.numerics.square_root import covariance_of, root_of
from rmpc_bench.types import Array, DesignError, Estimate, Estimator, Model, as_estimate


@dataclass(frozen=True, eq=False)
class WeightedFilter(Estimator):
    """A Kalman filter with weights of the outputs; axis 0 of a matrix is k and has length 1 if it is constant."""

    x0: Float[Array, " nx"]  # x0, P0: prediction before the first measurement and covariance of its error
    P0: Float[Array, "nx nx"]
    A: Float[Array, "kA nx nx"]  # A, B, C, f, d: model matrices and constant parts
    B: Float[Array, "kB nx nu"]
    C: Float[Array, "kC ny nx"]
    f: Float[Array, "kf nx"]
    d: Float[Array, "kd ny"]
    Q_w: Float[Array, "kQ nx nx"]  # Q_w, R_v: covariance of w, scale matrix of v
    R_v: Float[Array, "kR ny ny"]
    T: Float[Array, "kR ny ny"]  # inverse of the Cholesky factor of R_v
    law: WeightLaw  # how the weights are computed
    sets: NoiseSets  # sets of the noises on which P is based
    use_y0: bool = True  # whether to use y(0)
    # share of the decrease of P by a correction without weights, where P does not depend on the weights
    kept: float = 1.0

    bridges_missing = True
    form = "filter"

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """The innovation, its covariance without weights, and the weights of the whitened outputs."""
        ny = self.C.shape[1]
        return {"e": (ny,), "S": (ny, ny), "weight": (ny,)}

    def init(self, n_runs: int) -> OwnState:
        """Start every run at ``x0``."""
        return OwnState(np.tile(self.x0, (n_runs, 1)), np.tile(root_of(self.P0), (n_runs, 1, 1)))

    def correct(self, k: int, state: OwnState, y: Float[Array, "runs ny"]) -> tuple[OwnState, Estimate]:
        """Use what was measured of y(k), with weights."""
        check_signal("y", y, len(state.x), self.C.shape[1])
        missing = np.isnan(y)
        some = bool(missing.any())
        C, d, R_v, T = (at_sample(each, k) for each in (self.C, self.d, self.R_v, self.T))
        e, S, q, H = measured(C, d, R_v, whitening_of_runs(T, R_v, missing) if some else T[None], state, y)
        weight = np.zeros_like(y)
        if k > 0 or self.use_y0:
            count = y.shape[1] - missing.sum(axis=1) if some else None
            weight, state = corrected(self.law, state, q, H, count, self.kept)
            weight = np.where(missing, 0.0, weight) if some else weight
        info = {"e": e, "S": S, "weight": weight}
        return state, as_estimate(Estimate(state.x, covariance_of(state.root), info=info))

    def predict(self, k: int, state: OwnState, u: Float[Array, "runs nu"]) -> OwnState:
        """Predict k+1."""
        A, B, f, Q_w = (at_sample(each, k) for each in (self.A, self.B, self.f, self.Q_w))
        check_signal("u", u, len(state.x), B.shape[1])
        return predicted(A, B, f, Q_w, state, u)

    def warm_up(self) -> None:
        """Compile the kernels (or load them from the cache) with a step of one run."""
        state: Any = self.init(1)
        state, _ = self.correct(1, state, np.zeros((1, self.C.shape[1])))
        self.predict(0, state, np.zeros((1, self.B.shape[2])))


def weighted_filter(
    model: Model,
    n_steps: int,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    law: WeightLaw,
    *,
    use_y0: bool = True,
    kept: float = 1.0,
    share: float = 1.0,
) -> WeightedFilter:
    """Create a filter with `share` times R_v; a DesignError says that R_v is singular or the noises are correlated."""
    models = uncorrelated(model, n_steps)
    names = {"A": "A", "B": "B", "C": "C", "f": "f0", "d": "d0", "Q_w": "Q_w", "R_v": "R_v"}
    matrices = {ours: over_time([getattr(each, theirs) for each in models]) for ours, theirs in names.items()}
    matrices["R_v"] = share * matrices["R_v"]
    try:
        T = whitening(matrices["R_v"])
    except np.linalg.LinAlgError:
        raise DesignError(
            "R_v is singular: weights of outputs need measurement noise in all of them; use kalman without it"
        ) from None
    return WeightedFilter(x0, P0, **matrices, T=T, law=law, sets=stochastic_sets(model), use_y0=use_y0, kept=kept)
