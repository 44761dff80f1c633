"""Stationary Kalman filter from a solution of the Riccati equation that something else has found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.bridging import RiccatiRecursion
from rmpc_bench.estimators.gain_schedule import (
    Form,
    GainScheduleFilter,
    predictor_schedule,
    singular_innovation,
    uncorrelated,
)
from rmpc_bench.models.noise_sets import stochastic_sets
from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.numerics.riccati import filter_step
from rmpc_bench.numerics.square_root import root_of
from rmpc_bench.types import Array, DesignError, Model


def stationary_filter(
    model: Model,
    x0: Float[Array, " nx"],
    K: Float[Array, "nx ny"],
    P_pred: Float[Array, "nx nx"],
    form: Form,
) -> GainScheduleFilter:
    """Return the filter with the gain K and the solution P_pred of the Riccati equation of its one-step predictor.

    A run has gains of its own after a missing measurement.  A DesignError says that the model depends on k, its noises
    are correlated, or the covariance of the innovation is singular.
    """
    if model.varies:
        raise DesignError("stationary gains need a design model that does not depend on k; use kalman")
    now = uncorrelated(model, 0)[0]
    try:
        step = filter_step(now.A, now.C, now.Q_w, now.R_v, root_of(P_pred))
    except np.linalg.LinAlgError:
        raise singular_innovation(0) from None
    S = symmetrise(now.C @ P_pred @ now.C.T + now.R_v)
    predictor = replace(predictor_schedule([now], x0, [K], [P_pred]), sets=stochastic_sets(model), S=S[None])
    own = RiccatiRecursion([now], corrects=form == "filter")
    predictor = replace(predictor, root=root_of(P_pred)[None], recursion=own)
    return predictor if form == "predictor" else replace(predictor, L=step.L[None], P=step.P[None])
